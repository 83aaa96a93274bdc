"""Egos of several scenes that are asked at once: each answers what it would alone."""

from litsim_policy.ego.batched import BatchedEgos
from litsim_policy.ego.following import FollowingEgo
from litsim_policy.ego.idm import IdmEgo
from litsim_policy.ego.log import LogEgo
from litsim_policy.ego.perturbed import PerturbedConfig, PerturbedEgo
from litsim_policy.motion.car_following import IdmConfig
from litsim_sim.core.scene import AgentTable, EgoMode
from litsim_sim.scenario.batched import BatchedScenario


def test_egos_that_follow_with_models_of_their_own_answer_as_alone(make_scenario, track, lane_centres) -> None:
    """A scene of few agents beside one of many; somebody stands where only the egos of the other scenes are."""
    y = lane_centres[1]
    quiet = make_scenario(track(7, x=60.0, y=y, speed=9.0), track(9, x=90.0, y=y, speed=7.0))
    jam = make_scenario(*(track(20 - k, x=60.0 + 9.0 * k, y=y + 0.3, speed=6.0 - k) for k in range(5)))
    scenes = (quiet, jam, quiet.around(9, 1), quiet, jam)
    perturbed = PerturbedConfig(kind="brake", time=(0.5, 0.5), duration=0.5)

    def egos():
        brisk = IdmConfig(desired_speed=14.0, headway=0.9, acceleration=2.0)
        first, second, third, fourth, fifth = scenes
        return [
            IdmEgo(first),
            IdmEgo(second, brisk),
            PerturbedEgo(third, perturbed),
            LogEgo(fourth),
            IdmEgo(fifth),
        ]

    batch, alone, modes = BatchedScenario.of(scenes), egos(), []
    assert [isinstance(ego, FollowingEgo) for ego in alone] == [True, True, True, False, True]
    together = BatchedEgos(batch, egos())
    for step in range(quiet.history_steps, quiet.history_steps + 20):
        expected = [ego.plan(scene.log.table(step)) for ego, scene in zip(alone, scenes, strict=True)]
        assert together.plan(batch.log.table(step), range(5)) == expected
        modes.append([command.mode for command in expected])
        assert len({command.acceleration for command in expected[:2]}) == 2
    assert {mode[2] for mode in modes} == {EgoMode.FOLLOW_LOG, EgoMode.CONTROL}


def test_who_is_not_asked_answers_nothing_and_a_gone_ego_neither(make_scenario, track) -> None:
    scene = make_scenario(track(7, x=60.0, last=30), track(9, x=90.0))
    batch = BatchedScenario.of((scene, scene))
    together = BatchedEgos(batch, [IdmEgo(scene), IdmEgo(scene)])
    table: AgentTable = batch.log.table(scene.history_steps)
    first, second = together.plan(table, [1])
    assert (first.acceleration, first.yaw_rate) == (0.0, 0.0) and second.acceleration != 0.0
    without = table.take(table.scene == 1)
    first, second = together.plan(without, [0, 1])
    assert (first.acceleration, first.yaw_rate) == (0.0, 0.0) and second.acceleration != 0.0
