"""Data for training and evaluation: sources, tracks, and batches of scenes."""
