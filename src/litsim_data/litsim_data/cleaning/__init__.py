"""Cleaning of noisy tracks: positions, speeds, accelerations and headings that agree with each other."""
