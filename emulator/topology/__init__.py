"""Says which processors there are, how they are wired, where their sockets lie, and what a computer can hold."""
