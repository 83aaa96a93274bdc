"""Measures of a recorded run, computed from its MCAP file alone; what a measure is, and tables of their values."""
