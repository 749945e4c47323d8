"""Works out for one ray at a time, straight from the equations, what the machine works out over lanes."""
