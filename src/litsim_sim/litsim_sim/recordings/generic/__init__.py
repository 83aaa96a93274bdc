"""Any table of trajectories to a recording, by a mapping that a person writes or has drafted."""
