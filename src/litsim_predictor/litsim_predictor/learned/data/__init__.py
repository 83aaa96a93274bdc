"""From recordings to batches: tracks, scenes, features, rasters."""
