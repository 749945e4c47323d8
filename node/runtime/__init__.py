"""Runs a living node: its processor, its state, the event loop, reductions, increments, probes and reports."""
