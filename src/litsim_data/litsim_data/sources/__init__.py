"""Data sets as they are published: tracks, lanes, signals and licence of each, in one interface, and their import."""
