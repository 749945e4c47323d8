"""Drives an array through its corners: load, trace, collect, increments; over processes or in memory."""
