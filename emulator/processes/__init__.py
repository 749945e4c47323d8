"""Launches and supervises the nodes' processes: fork server, control channels, the array of real processes."""
