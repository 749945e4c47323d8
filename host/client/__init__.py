"""Speaks with an array that stays: the protocol, its requests, the connection, and the client itself."""
