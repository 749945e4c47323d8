"""The array: topology, split of space, launching and supervising processes, loading, waves, collection.

Imports ``raygrid.node`` only.
"""
