"""Carries messages between two neighbours: the link protocol over channels of ZeroMQ, of memory, or bad on purpose."""
