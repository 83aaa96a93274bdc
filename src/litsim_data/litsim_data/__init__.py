"""Recordings in and out: formats, cleaning, maps, generated traffic, segments and mined scenarios."""
