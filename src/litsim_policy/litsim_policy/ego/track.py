"""The ego `track`, which drives what its vehicle truly did in an encounter, while its log keeps its pace.

See :mod:`litsim_sim.scenario.encounter_note`. The ego is off its log from the onset on, as any driving system would be.
"""

from __future__ import annotations

import numpy as np

from litsim_policy.ego.ego import Ego
from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import STEP_S, AgentTable, EgoCommand
from litsim_sim.scenario.encounter_note import EncounterNote
from litsim_sim.scenario.scenario import Scenario

GAIN = 2.0  # [1/s] of the return to the track: tracks and vehicles hardly differ
TURN_REACH = 0.5  # [m] least distance of the centre from what it turns about


class TrackEgo(Ego):
    """Draws the box centre along the recorded track, as the rear axle follows the heading.

    Speeds and places of the track are fed forward, so that what is left to correct are the errors of its samples.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Raises an InputError if the recording of `scenario` does not tell an encounter."""
        self._track = EncounterNote.of_scenario(scenario).truth.opponent.track
        self._ego, self._begin = scenario.ego_id, scenario.history_steps
        self._rear_axle = scenario.vehicle.rear_axle

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.ego.Ego`."""
        row, step, track = table.row(self._ego), table.step, self._track
        if row < 0 or not self._begin <= step < len(track) - 1:
            return EgoCommand(step)
        error = np.array([track.x[step] - table.x[row], track.y[step] - table.y[row]])
        way = np.array([track.x[step + 1] - track.x[step], track.y[step + 1] - track.y[step]])
        dx, dy = np.column_stack([error, way + GAIN * STEP_S * error])
        ahead, left = to_body(dx, dy, table.yaw[[row, row]])
        speed = float(table.speed[row])
        wanted = max(float(track.speed[step + 1] + GAIN * ahead[0]), 0.0)
        # in a step, the centre moves to the left by this distance for each radian (see core.dynamics)
        reach = self._rear_axle * float(table.length[row]) + 0.25 * STEP_S * (speed + wanted)
        return EgoCommand(step, (wanted - speed) / STEP_S, float(left[1]) / STEP_S / max(reach, TURN_REACH))
