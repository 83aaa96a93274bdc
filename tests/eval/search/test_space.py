"""The space of a search: every proposal is a scenario that can be loaded, and says what it changes."""

import numpy as np
import pytest

from litsim_eval.search.people import DECLARED, PARAMETERS, People
from litsim_eval.search.space import NOTHING, Proposal, Space
from litsim_sim.core.scene import Controller, ControlTable, EgoCommand
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.world import World

EGO, LEADER, BESIDE, LATE = 1, 2, 3, 4


@pytest.fixture(scope="module")
def space(make_scenario, track, lane_centres) -> Space:
    tracks = (
        track(EGO, x=100.0, last=100),
        track(LEADER, x=140.0, last=100),
        track(BESIDE, x=108.0, y=lane_centres[2], last=100),
        track(LATE, x=60.0, first=12, last=100),
    )
    return Space.of(make_scenario(*tracks), People.load())


def test_every_proposal_can_be_loaded(space: Space) -> None:
    random, acts = np.random.default_rng(0), set()
    for number in range(60):
        proposal = space.drawn(random).scaled(3.0)  # farther than is usual
        acts.add(proposal.act)
        text = space.scenario_file(proposal, f"made_{number}")
        scenario = Scenario.from_yaml(text, "text")
        assert scenario.file.changes == space.changes(proposal)
        assert all(change.text in scenario.file.description for change in scenario.file.changes)
        assert scenario.ego_id == EGO and (space.distance(proposal) > 0.0) == bool(scenario.file.changes)
    assert acts == {NOTHING, "brake", "cut_in", "cut_out", "pace", "enter"}


@pytest.mark.parametrize("name", [each.name for each in PARAMETERS if each.declared and each.name != "signals.later_s"])
def test_what_is_declared_is_named_in_the_scenario(space: Space, name: str) -> None:
    kind, _, field = name.partition(".")
    named = Space.of(space.scenario, space.people, [kind])
    act = kind if kind in named.agents else NOTHING
    proposal = Proposal(act, LEADER if act == kind else -1, 1.0, {name: 2.0})
    assert named.varied(act) == [name] and named.distance(proposal) == pytest.approx(2.0)
    scenario = Scenario.from_yaml(named.scenario_file(proposal, "declared"), "text")
    (change,) = scenario.file.changes
    habit = DECLARED[next(each.habit for each in PARAMETERS if each.name == name)]
    assert change.kind == kind and getattr(change, field) == pytest.approx(habit.value(2.0))
    assert change.text in scenario.file.description


@pytest.mark.parametrize("name", ["brake.deceleration", "pace.factor", "enter.later_s", "hide.duration_s"])
def test_an_act_as_recorded_is_none(space: Space, name: str) -> None:
    kind = name.partition(".")[0]
    named = Space.of(space.scenario, space.people, [kind])
    agent = LATE if kind == "enter" else LEADER
    for z, acts in ((0.04, False), (2.0, True)):
        proposal = Proposal(kind, agent, 1.0, {name: z})
        assert bool(named.changes(proposal)) == acts == (named.distance(proposal) > 0.0)
    assert named.within(Proposal(kind, agent, 1.0, {name: 2.0}), 0.01) is None  # nor is it proposed


@pytest.mark.parametrize("act", ["brake", "cut_in", "cut_out"])
def test_that_an_agent_acts_at_all_is_as_far_as_it_is_rare(space: Space, act: str) -> None:
    agent = BESIDE if act == "cut_in" else LEADER
    far = space.distances(Proposal(act, agent, 1.0, {f"{act}.duration_s": 1.0}))
    first, last = space.steps
    assert far[f"{act}.occurs"] == space.people.rates[act].distance(0.1 * (last - first + 1)) > 0.0


def test_a_cut_in_is_as_far_as_the_headway_that_it_leaves(space: Space) -> None:
    close = space.distances(Proposal("cut_in", BESIDE, 1.0, {"cut_in.duration_s": 1.0}))
    assert close["cut_in.headway_s"] > 2.0  # 3.5 m at 10 m/s
    assert close["cut_in.duration_s"] == 1.0


def test_no_agent_enters_in_the_history(space: Space) -> None:
    (change,) = space.changes(Proposal("enter", LATE, 0.0, {"enter.later_s": -6.0}))
    assert change.model_dump() == {"kind": "enter", "agent": LATE, "later_s": -0.8}  # to step 4, the first after it


def test_agents_that_a_scenario_has_changed_already_stay_as_they_are(space: Space) -> None:
    brake = Proposal("brake", LEADER, 2.0, {"brake.deceleration": 2.0, "brake.duration_s": 1.0})
    again = Space.of(Scenario.from_yaml(space.scenario_file(brake, "changed"), "text"), space.people)
    assert "brake" not in again.agents and LEADER not in again.agents["pace"]
    more = Scenario.from_yaml(again.scenario_file(Proposal(z={"start.left": 1.0}), "more"), "text")
    assert [change.kind for change in more.file.changes] == ["brake", "start"]


@pytest.mark.parametrize(("act", "ego"), [("brake", -1.0), ("cut_in", 1.0), ("cut_out", -1.0)])
def test_an_act_begins_when_it_says_unless_other_changes_move_the_ego(space: Space, act: str, ego: float) -> None:
    agent, z = BESIDE if act == "cut_in" else LEADER, {f"{act}.duration_s": 1.0}
    proposal = Proposal(act, agent, 2.0, z | ({"brake.deceleration": 2.0} if act == "brake" else {}))
    scenario = Scenario.from_yaml(space.scenario_file(proposal, "waits"), "text")
    world, begins = World(scenario, guard_entries=False), list[int]()
    for acceleration in (0.0, ego):
        table = world.reset()
        while table.controller[table.row(agent)] == Controller.LOG and table.step < 60:
            table = world.step(ControlTable.empty(table.step), EgoCommand(table.step, acceleration))
        begins.append(table.step - 1)
    assert begins[0] == 20
    assert begins[1] > 20  # the ego is not so near to a leader any more, and too near for a cut-in
