"""Conflict detection, takeover and policies, ego drivers and experiments."""

import litsim_sim  # noqa: F401  before numpy, whose code it chooses
