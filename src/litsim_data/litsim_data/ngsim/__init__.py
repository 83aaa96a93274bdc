"""NGSIM: reading, repair and conversion of its official files."""
