"""What networks that drive see: their observations, group by group."""
