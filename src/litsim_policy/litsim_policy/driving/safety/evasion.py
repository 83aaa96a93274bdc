"""Evasive commands: what an agent may do instead of a command that leads into a contact."""

from __future__ import annotations

import numpy as np

from litsim_policy.driving.safety.comfort import ACCELERATION_MAX, LATERAL_ACCELERATION_MAX, YAW_ACCELERATION_MAX
from litsim_sim.core.dynamics import SPEED_MIN
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import STEP_S
from litsim_sim.kernels.compiled import Floats, Floats2, Floats3, Ints, kernel

BRAKING = np.array([2.0, 3.0, 4.0, 6.0])  # [m/s2] braking that is tried before the hardest


@kernel
def evasive_commands(
    commands: Floats2, speed: Floats, yaw_rate: Floats, path_yaw_rate: Floats, lane_yaw_rate: Floats, braking_max: float
) -> Floats3:
    """Alternatives to the commands, nearest to the commanded acceleration first, and after all of them swerves.

    Acceleration is among them, since it may be best for an agent that another cuts in on from behind. Swerves to
    either side, as fast as turns may begin, are the last resort for an agent beside which another moves over: no
    braking takes it out of the way in time.

    Commands are (k, 2) accelerations [m/s2] and yaw rates [rad/s]. Returns (k, 35, 2): as commanded, along the
    path, along the lane; then with other accelerations; then, with each of them, to the right and to the left.
    """
    turn_step = YAW_ACCELERATION_MAX * STEP_S  # most by which a yaw rate changes in a step [rad/s]
    strengths = len(BRAKING) + 3
    choices = np.empty((len(commands), 5 * strengths, 2))
    for i in range(len(commands)):
        wanted = commands[i, 0]
        bound = LATERAL_ACCELERATION_MAX / max(speed[i], SPEED_MIN)
        low, high = yaw_rate[i] - turn_step, yaw_rate[i] + turn_step
        along_path = within(within(path_yaw_rate[i], low, high), -bound, bound)
        along_lane = within(within(lane_yaw_rate[i], low, high), -bound, bound)
        steering = (commands[i, 1], along_path, along_lane)
        swerves = (within(low, -bound, bound), within(high, -bound, bound))
        driving_on = max(ACCELERATION_MAX, wanted)
        hardest = min(wanted, -braking_max)
        accelerations = np.full(strengths, hardest)
        accelerations[0], accelerations[-1] = wanted, driving_on
        for k in range(len(BRAKING)):
            accelerations[k + 1] = min(wanted, max(-BRAKING[k], -braking_max))
        for place, k in enumerate(np.argsort(np.abs(accelerations - wanted), kind="mergesort")):
            for s in range(3):
                choices[i, 3 * place + s, 0], choices[i, 3 * place + s, 1] = accelerations[k], steering[s]
            for s in range(2):
                choice = 3 * strengths + 2 * place + s
                choices[i, choice, 0], choices[i, choice, 1] = accelerations[k], swerves[s]
    return choices


@kernel
def best_choice(choices: Floats3, touch: Floats2) -> Ints:
    """Positions (k,) of the `choices` (k, c, 2) to take, which lead to a first contact after `touch` (k, c) [s].

    The first that touches no agent; if there is none, of those that touch latest, the one that brakes hardest.
    """
    best = np.zeros(len(choices), np.int64)
    for i in range(len(choices)):
        latest, least = -1.0, np.inf
        for c in range(choices.shape[1]):
            later = touch[i, c] > latest
            if later or (touch[i, c] == latest and touch[i, c] < np.inf and choices[i, c, 0] < least):
                best[i], latest, least = c, touch[i, c], choices[i, c, 0]
    return best
