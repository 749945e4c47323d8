"""Carries out the commands, a module each."""
