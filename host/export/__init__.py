"""Writes scenes for other renderers."""
