"""Measures of a recorded run, computed from its MCAP file alone; one module per family of measures."""
