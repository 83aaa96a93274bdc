"""The networks, by name, and their weights."""
