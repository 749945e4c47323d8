"""Renders frames: what an array needs, what it holds, retries, statistics, and the Python interface."""
