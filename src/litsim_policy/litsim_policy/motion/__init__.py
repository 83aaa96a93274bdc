"""Where agents can go: reference paths, routes, curves, and how they follow each other."""
