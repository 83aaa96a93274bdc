"""Recorded traffic in one neutral schema: reading known formats, cropping, and cutting into segments."""
