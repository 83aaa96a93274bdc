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
        description = DESCRIPTION.format(opponent=note.opponent, agent=note.agent)
        notes = {NOTE: note.model_dump(mode="json")}
        history = note.onset_step
        return Encounter.of_scenario(self.scenario(name, columns, note.opponent, history, description, notes))

    def scenario(
        self,
        name: str,
        columns: Mapping[str, np.ndarray],
        ego: int,
        history_steps: int,
        description: str = "",
        notes: Mapping[str, object] | None = None,
    ) -> Scenario:
        """Returns a scenario around `ego` with the log in the `columns` of a recording, with `notes` in its header."""
        header = RecordingHeader(
            name=name,
            source=self.source,
            licence=self.licence,
            net=self.net.name,
            notes=dict(notes or {}),
            signals=dict(self.signals),
        )
        steps = int(columns["frame"].max() - columns["frame"].min())
        file = ScenarioFile(
            name=name,
            description=description,
            recording=f"{name}.parquet",
            net=str(self.net),
            history_s=history_steps * STEP_S,
            simulation_s=(steps - history_steps) * STEP_S,
            ego=ego,
            roi_m=REACH,
            coverage_min=0.0,
        )
        return Scenario(file, name, Sources(Recording.from_columns(header, columns, name), self.lane_map))
