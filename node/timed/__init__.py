"""Keeps machine time in a node: the service clock, conservative look-ahead, and the processor that uses both."""
