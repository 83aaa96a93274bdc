"""Conversion of any table of trajectories to a recording, by a mapping file."""
