"""Noisy tracks made plausible: positions, speeds, accelerations and headings that agree."""
