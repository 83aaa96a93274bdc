"""The joint predictor's view of the road: units of its inputs, and the neighbours that an agent attends to."""

from __future__ import annotations

LENGTH = 20.0  # [m] by which positions are scaled
LANE = 4.0  # [m] by which lateral distances are scaled
SPEED = 15.0  # [m/s] by which speeds are scaled
HISTORY_UNITS = (LENGTH, LENGTH, 1.0, SPEED)
"""By which the channels of a history are scaled."""
DEVIATION_UNITS = (2.0, 1.0, 0.1, 2.0)
"""By which they are scaled where histories are given as differences from constant speed straight ahead [m], [m], [rad],
[m/s], so that they are about as large as 1."""
STATE_UNITS = (LENGTH, LENGTH, SPEED, 1.0)
"""By which the channels of a state are scaled, so that they are about as large as 1."""
NEAR = 5.0  # [m] ahead or behind at which an agent counts as half as near as beside
RELATION_CHANNELS = 8
RELATION_UNITS = (LENGTH, LANE, 1.0 / NEAR, 1.0, 1.0, 0.25 * SPEED, SPEED, 1.0)
"""By which the channels of a relation are scaled: offset ahead and to the left [m], nearness along [1/m], cosine and
sine of the turn, how much faster, how fast [m/s], and the side in the lane: 1 ahead, -1 behind, 0 beside the lane."""
MAP_MIDDLE = 127.5  # middle of the bytes of a map, which are scaled to -1 to 1
SCALE_FLOOR = 0.02  # [m] least standard deviation: below what the recordings measure
CORRELATION_LIMIT = 0.95
GAUSSIAN_CHANNELS = 5  # outputs per step: mean x and y, two scales, correlation
RELATION_WIDTH = 64  # width of the layer that reads a relation
TRAFFIC_KNOTS = (0.0, 25.0, 60.0, 100.0, 160.0, 240.0)
"""[m] ahead: traffic counts fully for one of the inner knots where it is there, not at all at the knots next to it."""
TRAFFIC_WIDTHS = (3.5, 30.0)
"""Lateral distances [m] from which on traffic no longer counts: as of the agent's own lane, and as of all lanes."""
TRAFFIC_SOME = 0.25  # number of vehicles: means over fewer tend to 0
TRAFFIC_AGO = 5  # steps of a history over which changes of speed are measured: a second
TRAFFIC_UNITS = (0.25 * SPEED, 0.1 * SPEED, 1.0)
"""Scales of the features of a place: how much faster traffic is there, how much it gained [m/s], how many vehicles."""
TRAFFIC_PLACES = len(TRAFFIC_WIDTHS) * (len(TRAFFIC_KNOTS) - 2)
TRAFFIC_CHANNELS = TRAFFIC_PLACES * len(TRAFFIC_UNITS)
