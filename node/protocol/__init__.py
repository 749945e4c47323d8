"""Defines every byte that travels: packets, messages, commands of waves, counters, timestamps."""
