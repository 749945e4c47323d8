"""Loads user code into a node: the form of a program, its compilation, and where it enters the ray step."""
