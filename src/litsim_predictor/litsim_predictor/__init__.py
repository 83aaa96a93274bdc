"""Joint predictors, kinematic and learned, and their node."""

import litsim_sim  # noqa: F401  before numpy, whose code it chooses
