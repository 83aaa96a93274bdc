"""Training of reactions: by how much people change their speed behind a leader."""
