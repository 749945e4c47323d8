"""The array: topology, partition of space, launching and supervising processes, driving, simulation, analysis."""
