"""Scenes, recordings, the SUMO world, bridge, recorder, launcher and analysis."""
