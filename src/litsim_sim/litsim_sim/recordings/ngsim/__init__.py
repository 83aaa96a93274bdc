"""NGSIM: its official files, read in blocks, mended and converted."""
