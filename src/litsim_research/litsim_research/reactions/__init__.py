"""Reactions, fitted to people: by how much they change their speed behind a leader, and how they follow it."""
