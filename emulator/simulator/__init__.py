"""Simulates a whole array in one process and in machine time."""
