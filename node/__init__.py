"""One processor of the array: packets, links, its box of space, surfaces, the ray step and the main loop."""
