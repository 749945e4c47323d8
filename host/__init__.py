"""The front end: command line, scenes, cameras, images, statistics.

Imports ``raygrid.emulator`` and ``raygrid.node``.
"""
