"""Holds space and surfaces: the lattice, the walk over cells, surfaces and their motions, hits, the hierarchy, the flood's tree."""
