"""Recorded traffic in one neutral schema: reading any known format, cropping, cutting into segments."""
