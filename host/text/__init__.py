"""Makes text fit to be shown: errors, misuse, tables, spans of time, whatever a scene or a name has put into it."""
