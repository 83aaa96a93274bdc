"""Several scenes as one: their logs, ids and tables put together and taken apart again."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.scene import ARRAY_FIELDS, AgentTable, ControlTable
from litsim_sim.scenario.batched import BatchedScenario, kind
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.world import World


@pytest.fixture(scope="module")
def scenes(make_scenario: Callable[..., Any], track: type) -> list[Scenario]:
    """Two recordings of different length with vehicles at the same places, the ids of one beyond 32 bits."""
    short = make_scenario(track(5, x=100.0), track(2, x=150.0, first=10), track(9, x=300.0, last=8))
    ids = (-4, 2**45, 2**45 + 1, 7)
    return [short, make_scenario(*(track(k, x=100.0 + 20.0 * n, last=90) for n, k in enumerate(ids)))]


def columns(table: AgentTable) -> list[list[float]]:
    return [getattr(table, f).tolist() for f in ARRAY_FIELDS]


def test_a_table_of_the_joined_log_comes_apart_into_those_of_the_logs(scenes: list[Scenario]) -> None:
    batch = BatchedScenario.of(scenes)
    assert batch.total_steps == batch.log.steps - 1 == scenes[1].total_steps > scenes[0].total_steps
    for step in range(batch.log.steps):
        table = batch.log.table(step)
        assert (np.diff(table.id) > 0).all()
        apart = batch.tables(table)
        assert [columns(own) for own in apart] == [columns(scene.log.table(step)) for scene in scenes]
        assert table.scene.tolist() == [k for k, own in enumerate(apart) for _ in range(len(own))]
        assert table.take(table.scene == 1).scene.tolist() == [1] * len(apart[1])
        halves = [table.take(table.scene == k) for k in (1, 0)]
        assert columns(AgentTable.merged(step, halves)) == columns(table)


def test_a_batch_knows_the_ids_of_the_recordings(scenes: list[Scenario]) -> None:
    batch = BatchedScenario.of(scenes)
    for k, scene in enumerate(scenes):
        for agent in scene.log.ids.tolist():
            assert batch.recorded_id_in(k)(batch.agent(k, agent)) == agent
            assert batch.recorded_id_in(1 - k)(batch.agent(k, agent)) is None
        assert batch.ego_ids[k] == batch.agent(k, scene.ego_id)
    both = np.array([batch.agent(0, 9), batch.agent(1, -4)])
    values = np.arange(2.0)
    apart = batch.controls(ControlTable(3, both, values, values, values, np.ones(2, np.uint8)))
    assert [own.id.tolist() for own in apart] == [[9], [-4]]
    assert [own.acceleration.tolist() for own in apart] == [[0.0], [1.0]]


def test_boxes_at_the_same_place_in_different_scenes_do_not_touch(scenes: list[Scenario]) -> None:
    world, alone = World(BatchedScenario.of(scenes)), [World(scene) for scene in scenes]
    world.reset()
    for each in alone:
        each.reset()
    assert world.contacts == {} == alone[0].contacts == alone[1].contacts
    near = [scenes[0], scenes[0].around(5, 8)]
    assert World(BatchedScenario.of([*near])).reset().x.tolist() == [*scenes[0].log.table(0).x] * 2


def test_each_scene_has_its_own_signals(make_scenario, track) -> None:
    def scene(red_until: float, last: int, groups: tuple[str, ...] = ("a", "b")) -> Scenario:
        """West is red until then; its group is the first by name in one scene and the second in another."""
        changes = [[0.0, groups[0], "red"], [red_until, groups[0], "green"], [0.0, groups[1], "amber"]]
        lanes = {groups[0]: ["WA_0", "WA_1"], groups[1]: ["BA_0"]}
        return make_scenario(
            track(1, x=220.0, y=-4.95, speed=0.0, last=last),
            net="urban_like",
            signals={
                "groups": lanes,
                "changes": changes,
            },
        )

    scenes = [scene(1.0, 40), scene(2.0, 60, ("d", "c"))]
    signals = BatchedScenario.of(scenes).signals
    assert signals is not None and signals.links is scenes[0].signals.links
    for step in (0, 9, 10, 19, 20, 40, 59, 80):
        alone = [each.signals.table(step).state[each.signals.link_group] for each in scenes]
        assert np.array_equal(signals.of_links(step), np.array(alone))
        assert all(np.array_equal(each.signals.of_links(step), [own]) for each, own in zip(scenes, alone, strict=True))
    assert (signals.of_links(15)[0] != signals.of_links(15)[1]).any()
    other = make_scenario(track(1, x=220.0, y=-4.95, speed=0.0, last=40), net="urban_like")
    assert len({kind(scenes[0]), kind(scenes[1]), kind(other)}) == 2, "without signals, nobody stops"


def test_what_stages_ask_of_a_scenario_decides_what_can_be_joined(make_scenario, track) -> None:
    scene = make_scenario(track(1, x=100.0))
    assert kind(scene) == kind(scene.around(1, 5)) == kind(make_scenario(track(3, x=50.0)))
    others = [{"roi_m": 50.0}, {"history_steps": 4}, {"vehicle": {"lag_s": 0.3}}]
    for other in others:
        differs = make_scenario(track(1, x=100.0), **other)
        assert kind(differs) != kind(scene)
        with pytest.raises(ValueError, match="cannot be batched"):
            BatchedScenario.of([scene, differs])
