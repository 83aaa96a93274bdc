"""The joint predictor by kernels: every agent alike, to the last bit, whatever else is asked or seen."""

from dataclasses import fields, replace

import numpy as np
import pytest

from litsim_predictor.inference.contract import (
    DT,
    HISTORY,
    HISTORY_CHANNELS,
    MODE_SHARE,
    AgentFutures,
    AgentInputs,
)
from litsim_predictor.inference.joint.kernels import read_histories
from litsim_predictor.inference.joint.network import JointNetwork, runs, shapes
from litsim_predictor.inference.joint.parameters import JointParameters
from litsim_predictor.inference.weights import read_weights
from made_agents import scene


@pytest.fixture(scope="module")
def network() -> JointNetwork:
    return JointNetwork(read_weights("default"))


def rows(inputs: AgentInputs, which: list[int]) -> AgentInputs:
    return replace(inputs, **{field.name: getattr(inputs, field.name)[which] for field in fields(inputs)})


def both(a: AgentInputs, b: AgentInputs) -> AgentInputs:
    joined = {f.name: np.concatenate([getattr(a, f.name), getattr(b, f.name)]) for f in fields(a)}
    return AgentInputs(**joined)


def assert_rows_equal(some: AgentFutures, of: AgentFutures, which: list[int]) -> None:
    for name in ("maneuver", "mean", "scale", "correlation"):
        assert np.array_equal(getattr(some, name), getattr(of, name)[which]), name


@pytest.mark.parametrize("which", [[0], [19], [3, 4, 11], [11, 3], list(range(19, -1, -1))])
def test_who_is_asked_with_others_is_answered_as_alone(network: JointNetwork, which: list[int]) -> None:
    inputs = scene(20)
    assert_rows_equal(network(inputs, np.array(which)), network(inputs, np.arange(20)), which)


def test_who_is_out_of_reach_changes_no_bit(network: JointNetwork) -> None:
    """Far away beyond all reach another scene begins: as if each were alone."""
    here, far = scene(30), scene(17, seed=1)
    # Whole metres, in single precision without rounding: places are told relative to the first agent's.
    here, far = (replace(each, frame=np.rint(each.frame)) for each in (here, far))
    far = replace(far, frame=far.frame + np.array([4096.0, 0.0, 0.0]))
    together = network(both(here, far), np.arange(47))
    assert_rows_equal(network(here, np.arange(30)), together, list(range(30)))
    assert_rows_equal(network(far, np.arange(17)), together, list(range(30, 47)))


def test_a_history_is_told_as_what_differs_from_constant_speed() -> None:
    """Who drove straight on is told by zeros, who has braked by how far it is ahead of that; unseen is unknown."""
    ago = DT * np.arange(HISTORY - 1, -1, -1)
    history, observed = np.zeros((2, HISTORY, HISTORY_CHANNELS), np.float32), np.ones((2, HISTORY), np.bool_)
    history[:, :, 0], history[:, :, 3] = -12.0 * ago, 12.0
    history[1, :, 0], history[1, :, 3] = -12.0 * ago - 0.5 * 2.0 * ago**2, 12.0 + 2.0 * ago
    observed[1, :4] = False
    history[1, :4] = 0.0
    told = np.empty((2, HISTORY, HISTORY_CHANNELS + 1), np.float32)
    read_histories(history, observed, DT, told)
    assert told[0] == pytest.approx(np.array([[0.0, 0.0, 0.0, 0.0, 1.0]] * HISTORY), abs=1e-5)
    assert not told[1, :4].any()
    assert told[1, 4:, 0] == pytest.approx(-(ago[4:] ** 2), abs=1e-5)
    assert told[1, 4:, 3] == pytest.approx(2.0 * ago[4:], abs=1e-5)


def test_who_is_near_does(network: JointNetwork) -> None:
    everybody = scene(8)
    without = network(rows(everybody, list(range(7))), np.arange(7))
    assert not np.array_equal(without.mean, network(everybody, np.arange(7)).mean)


def test_manoeuvres_that_matter_are_answered_beside_the_most_probable_one(network: JointNetwork) -> None:
    inputs, asked = scene(20), np.arange(20)
    one, several = network(inputs, asked), network(inputs, asked, 2)
    assert_rows_equal(several, one, list(range(20)))
    assert not len(one.further.row) and len(several.further.row) > 5
    probability, best = one.maneuver, one.maneuver.argmax(axis=1)
    expected = []
    for row in range(20):
        order = [k for k in np.argsort(-probability[row], kind="stable") if k != best[row]]
        expected += [(row, k) for k in order[:2] if probability[row, k] >= MODE_SHARE]
    assert list(zip(several.further.row.tolist(), several.further.maneuver.tolist(), strict=True)) == expected
    apart = np.abs(several.further.mean - one.mean[several.further.row])[:, -1].max(axis=1)
    assert (apart > 0.05).all(), "another manoeuvre leads elsewhere"


def test_more_manoeuvres_than_there_are_are_all(network: JointNetwork) -> None:
    inputs, asked = scene(3), np.arange(3)
    every, beyond = (network(inputs, asked, modes).further for modes in (8, 10**30))
    assert len(every.row) and np.array_equal(every.maneuver, beyond.maneuver) and np.array_equal(every.row, beyond.row)


def test_further_manoeuvres_do_not_depend_on_who_else_is_asked(network: JointNetwork) -> None:
    inputs, modes = scene(20), 3
    everybody, some = network(inputs, np.arange(20), modes).further, network(inputs, np.array([4, 11]), modes).further
    for position, row in enumerate((4, 11)):
        mine, same = everybody.row == row, some.row == position
        assert mine.any() and np.array_equal(everybody.mean[mine], some.mean[same])
        assert np.array_equal(everybody.maneuver[mine], some.maneuver[same])


def test_shapes_are_those_of_the_weights_and_odd_models_are_not_run() -> None:
    weights = read_weights("default")
    parameters = weights.parameters(JointParameters)
    assert shapes(parameters) == {name: array.shape for name, array in weights.arrays.items()}
    assert runs(weights)
    for other in ({"attention": "states"}, {"decoder": "recurrent"}):
        assert not runs(replace(weights, provenance=replace(weights.provenance, parameters=other)))
    assert not runs(read_weights("paper")) and not runs(read_weights("bat"))


def test_scenes_that_are_answered_together_are_answered_as_alone(network: JointNetwork) -> None:
    """Though they lie in one place; of one, nobody is asked."""
    scenes = [scene(20), scene(9, seed=1), scene(30, seed=2)]
    asked = [np.array([3, 7]), np.empty(0, np.int64), np.array([0, 29, 5])]
    begins = np.array([0, 20, 29])
    joined = both(both(*scenes[:2]), scenes[2])
    rows = np.concatenate([own + begin for own, begin in zip(asked, begins, strict=True)])
    together = network.of_scenes(joined, rows, begins)
    assert_rows_equal(network(scenes[0], asked[0]), together, [0, 1])
    assert_rows_equal(network(scenes[2], asked[2]), together, [2, 3, 4])
