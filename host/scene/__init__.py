"""Describes scenes: surfaces, materials, lights and cameras, checked and in one form, whatever the file."""
