"""Maps: lane queries on SUMO nets, and the nets of this package."""
