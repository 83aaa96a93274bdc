"""Parameters of the guard of policy C's safety layer."""

from __future__ import annotations

from litsim_sim.core.quantities import Acceleration, Flag, Horizon, Length, NonNegative, Positive, configuration


@configuration
class SafetyConfig:
    """The guard against contacts; the limits of :mod:`.comfort` always hold.

    Attributes:
        contact: brake or steer where the command leads into another box within `horizon`.
        braking_max: of the guard in an emergency, the most that the vehicle can do.
        horizon: of the look-ahead for other boxes.
        margin: distance kept to other boxes.
    """

    contact: Flag = True
    braking_max: Positive[Acceleration] = 8.0
    horizon: Horizon = 1.2
    margin: NonNegative[Length] = 0.15
