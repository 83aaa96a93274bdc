"""What a run leaves: the bag, read back as arrays, repaired, played again; its digest."""
