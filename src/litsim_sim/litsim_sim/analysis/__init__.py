"""Measures of a recorded run, from its MCAP file alone: one family of measures a file."""
