"""Outputs of SimNet: future poses of an agent in its own frame."""

FUTURE = 12
"""Steps of 0.1 s that are predicted; the first is executed."""
OUTPUTS = 3 * FUTURE
"""x ahead, y to the left [m] and turn [rad] after each step, relative to the present pose."""
FORMAT = "litsim simnet, 1"
SMALL_WIDTHS = (16, 32, 64, 64)
"""Channels after each convolution of the network."""
SMALL_HIDDEN = 128
"""Units of its hidden layer."""
