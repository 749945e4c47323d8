"""Traces rays through one cell: the ray step, a pure function of cell, surfaces, frame and packets, and what it reads and writes."""
