from typing import Any

import numpy as np
import pytest

from litsim_data.encounters.encounter import Encounter
from litsim_sim.core.errors import InputError
from made_encounters import AGENT, HISTORY, OPPONENT, STEPS, encounter_note, encounter_scenario


def test_an_encounter_is_read_from_the_header_of_its_recording() -> None:
    encounter = Encounter.of_scenario(encounter_scenario(encounter_note()))
    assert (encounter.note.agent, encounter.note.opponent, encounter.note.onset_step) == (AGENT, OPPONENT, HISTORY)
    assert (encounter.note.kind, encounter.note.split, encounter.licence) == ("leader_brakes", "tuning", "made")
    assert len(encounter.truth) == len(encounter.opponent_truth) == STEPS
    assert np.array_equal(encounter.truth.x, encounter_note()["truth"]["agent"]["x"])


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"kind": "overtakes"}, r"notes.encounter: field kind: Input should be 'leader_brakes'"),
        ({"onset_step": 5}, r"notes.encounter.onset_step is 5, expected the history, 40"),
        ({"opponent": AGENT}, r"notes.encounter.opponent is 2, expected the scenario's ego, 1"),
        ({"agent": 99}, r"notes.encounter.agent is 99, expected another vehicle"),
    ],
)
def test_a_header_that_does_not_fit_the_scenario_is_refused(changes: dict[str, Any], error: str) -> None:
    with pytest.raises(InputError, match=error):
        Encounter.of_scenario(encounter_scenario(encounter_note() | changes))


def test_holes_in_the_truth_are_refused() -> None:
    note = encounter_note()
    note["truth"]["agent"]["x"].pop()
    with pytest.raises(InputError, match=r"truth.agent.x has 100 entries, expected 101, one a step"):
        Encounter.of_scenario(encounter_scenario(note))


def test_a_scenario_without_an_encounter_is_refused() -> None:
    with pytest.raises(InputError, match=r"header: notes.encounter is missing"):
        Encounter.of_scenario(encounter_scenario(None))
