"""Is the command line: the commands and what they print."""
