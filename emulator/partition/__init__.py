"""Chooses the planes between cells: uniform, or balanced by a sampling pre-pass and its costs."""
