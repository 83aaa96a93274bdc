"""Runs in one process, many of them, runs of recorded stages again, and how long they take."""
