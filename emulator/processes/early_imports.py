"""Imports what a ready array needs, at the moment at which that costs nothing."""

from __future__ import annotations


def import_links() -> None:
    """Import what an array needs once its fork server is warm; it costs nothing beside the warming."""
    import zmq  # noqa: F401

    from raygrid.emulator.driver import driver  # noqa: F401
    from raygrid.emulator.driver.collector import load
    from raygrid.emulator.processes import node_processes, process_watch  # noqa: F401
    from raygrid.emulator.topology import topology, wiring  # noqa: F401
    from raygrid.node.geometry import spanning_tree  # noqa: F401
    from raygrid.node.links import zmq_channel  # noqa: F401

    load()
