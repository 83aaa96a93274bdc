"""Conflict detection, takeover and policies, ego drivers and experiments."""
