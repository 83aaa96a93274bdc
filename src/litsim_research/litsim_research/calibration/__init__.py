"""Calibrations of the detection of conflicts."""
