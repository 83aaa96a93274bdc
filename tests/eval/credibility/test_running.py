"""Runs of encounters: together as alone, by several processes, with drivers of their own seeds."""

import numpy as np
import pytest

from litsim_data.encounters.encounter import Encounter
from litsim_eval.credibility import running
from litsim_eval.credibility.running import Drive, DriveOrReason, RunKey, Setup, Task, drive, run_task
from litsim_sim.scenario.encounter_note import Track
from made_encounters import encounter_note, encounter_scenario


@pytest.fixture(scope="module")
def encounter() -> Encounter:
    return Encounter.of_scenario(encounter_scenario(encounter_note()))


def driven(outcome: DriveOrReason) -> Drive:
    assert isinstance(outcome, Drive)
    return outcome


def same(a: Track, b: Track) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in vars(a))


def test_an_agent_that_reacts_is_driven_and_replay_never_takes_over(encounter: Encounter) -> None:
    task = Task([encounter], [Setup("idm", "idm"), Setup("replay", "replay")])
    reacting, replayed = (driven(drive(task, [RunKey(setup, 0, 0)])[0]) for setup in (0, 1))
    assert reacting.taken_over_s == pytest.approx(0.1) and not reacting.contact
    assert len(reacting.track) == len(encounter.truth) and reacting.track.speed.min() < 10.0
    assert replayed.taken_over_s is None and replayed.contact  # nobody reacts to who brakes


def test_together_runs_are_what_they_are_alone(encounter: Encounter) -> None:
    task = Task([encounter], [Setup("idm", "idm")], drivers=3)
    together = drive(task, [RunKey(0, 0, k) for k in range(3)])
    (alone,) = drive(task, [RunKey(0, 0, 0)])
    assert all(same(driven(each).track, driven(alone).track) for each in together)  # idm draws nothing


def test_each_driver_is_a_draw_of_its_own(encounter: Encounter) -> None:
    task = Task([encounter], [Setup("idm", "idm")], drivers=2)
    first, second = (task.plan(RunKey(0, 0, k)).scenario for k in range(2))
    assert (first.identities == encounter.scenario.identities).all() and first.seed == second.seed
    assert (first.identities[:, 0] != second.identities[:, 0]).all()


def test_processes_drive_every_run_once(encounter: Encounter) -> None:
    task = Task([encounter] * 3, [Setup("idm", "idm"), Setup("replay", "replay")], drivers=2)
    runs = [run for run, _ in run_task(task, 2)]
    assert len(runs) == len(task) == len(set(runs)) == 12


def test_a_run_that_fails_is_told_and_the_others_go_on(encounter: Encounter, monkeypatch) -> None:
    def refuse(plan):
        raise RuntimeError(f"no run by {plan.policy}")

    monkeypatch.setattr(running.Simulation, "of", refuse)
    monkeypatch.setattr(running, "batch_simulation", refuse)
    outcomes = drive(Task([encounter] * 2, [Setup("idm", "idm")]), [RunKey(0, 0, 0), RunKey(0, 1, 0)])
    assert all(isinstance(each, str) and "no run by idm" in each for each in outcomes)
