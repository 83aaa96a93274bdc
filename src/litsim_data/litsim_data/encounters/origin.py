"""Where encounters come from, and the scenarios that are made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from litsim_data.encounters.encounter import Encounter
from litsim_sim.core.scene import STEP_S
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.encounter_note import NOTE, EncounterNote
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario, Sources
from litsim_sim.scenario.scenario_file import ScenarioFile

REACH = 60.0  # [m] field roi_m of the scenarios: followers at the largest headway are in it
DESCRIPTION = "From the onset on, the log keeps {opponent}, the ego, and {agent} at their pace."


@dataclass(frozen=True)
class Origin:
    """A recording on a net.

    Attributes:
        source: data set, site and period, as in a citation.
        licence: licence of the data.
        net: file of the net.
        lane_map: the lanes of that.
        signals: states of its signals, as in a recording's header.
    """

    source: str
    licence: str
    net: Path
    lane_map: LaneMap
    signals: Mapping[str, object] = field(default_factory=dict)

    def encounter(self, name: str, note: EncounterNote, columns: Mapping[str, np.ndarray]) -> Encounter:
        """Returns the encounter `name` that a `note` tells, with the log in the `columns` of a recording."""
        header = RecordingHeader(
            name=name,
            source=self.source,
            licence=self.licence,
            net=self.net.name,
            notes={NOTE: note.model_dump(mode="json")},
            signals=dict(self.signals),
        )
        file = ScenarioFile(
            name=name,
            description=DESCRIPTION.format(opponent=note.opponent, agent=note.agent),
            recording=f"{name}.parquet",
            net=str(self.net),
            history_s=note.onset_step * STEP_S,
            simulation_s=(len(note.truth.agent.x) - 1 - note.onset_step) * STEP_S,
            ego=note.opponent,
            roi_m=REACH,
            coverage_min=0.0,
        )
        recording = Recording.from_columns(header, columns, name)
        return Encounter.of_scenario(Scenario(file, name, Sources(recording, self.lane_map)))
