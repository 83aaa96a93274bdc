"""Scales by which the features that policies observe are divided, so that they are about as large as 1."""

LIMIT = 3.0  # features are clipped to +-LIMIT after scaling
LENGTH, WIDTH = 5.0, 2.0  # [m]
SPEED = 15.0  # [m/s]
ACCELERATION = 3.0  # [m/s2]
DISTANCE = 30.0  # [m] to agents and along the path
LATERAL = 3.66  # [m] a lane of NGSIM
EDGE = 10.0  # [m] to the edges of the road
CURVATURE = 0.05  # [1/m]
HEADING = 0.2  # [rad] to lane and path
YAW_RATE = 0.2  # [rad/s]
TIME = 5.0  # [s]
