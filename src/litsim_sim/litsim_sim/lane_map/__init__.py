"""The lanes of a SUMO net, and queries on them."""
