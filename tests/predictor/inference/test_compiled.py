"""Compiled models: the same bits again and again, without torch, and one line about files that are none."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from litsim_predictor.inference import GRAPHS, SHIPPED
from litsim_predictor.inference.contract import MANEUVERS, AgentFutures, Network, NetworkOfManeuvers
from litsim_predictor.inference.networks import compiled
from litsim_predictor.inference.weights import packaged, weights_path
from litsim_predictor.models import make_predictor
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import Scenario
from made_agents import scene

PREDICTS = """
import sys
from litsim_predictor.models import DEFAULT_MODEL, make_predictor, model_names
from litsim_sim.scenario.scenario import Scenario
scenario = Scenario.load("demo")
for model in model_names():
    forecast = make_predictor(model, scenario).forecast(scenario.log.table(0))
    assert len(forecast.id) and forecast.valid.all(), model
print(DEFAULT_MODEL, sorted(name for name in sys.modules if name.split(".")[0] in ("torch", "onnx")))
"""


def network(name: str) -> Network:
    found = compiled(name)
    assert found is not None
    return found


EVERYBODY = np.arange(20)


def own_arrays(futures: AgentFutures) -> dict[str, np.ndarray]:
    """What is answered of each agent's most probable manoeuvre."""
    return {name: values for name, values in vars(futures).items() if name != "further"}


def assert_same_bits(a: AgentFutures, b: AgentFutures) -> None:
    for one, other in ((own_arrays(a), own_arrays(b)), (vars(a.further), vars(b.further))):
        for name, values in one.items():
            assert np.array_equal(values, other[name]), name


@pytest.mark.parametrize("name", SHIPPED)
def test_equal_scenes_have_equal_bits_whatever_came_before(name: str) -> None:
    first, second = network(name), network(name)
    out = first(scene(20), EVERYBODY)
    second(scene(33, seed=1), np.arange(7))
    assert_same_bits(second(scene(20), EVERYBODY), out)
    assert not np.array_equal(first(scene(20, seed=1), EVERYBODY).mean, out.mean)


@pytest.mark.parametrize("name", SHIPPED)
def test_some_are_answered_as_they_are_among_all(name: str) -> None:
    answer = network(name)
    everybody = answer(scene(20), EVERYBODY)
    for rows in ([0], [19], [3, 4, 11], [11, 3], EVERYBODY[::-1]):
        some = answer(scene(20), np.array(rows))
        for field, values in own_arrays(some).items():
            np.testing.assert_allclose(
                values, getattr(everybody, field)[np.array(rows)], rtol=0, atol=1e-4, err_msg=field
            )


@pytest.mark.parametrize("name", ["default", "paper"])
def test_maps_that_were_seen_before_change_no_bit(name: str) -> None:
    """Some agents see the same map as others, some one of an earlier scene, some neither."""
    earlier, now = scene(20), scene(20, seed=1)
    raster = now.raster.copy()
    raster[3:8], raster[8:13] = raster[3], earlier.raster[8:13]
    now = replace(now, raster=raster)
    fresh, used = network(name), network(name)
    used(earlier, EVERYBODY)
    used(now, EVERYBODY)
    out = fresh(now, EVERYBODY)
    assert_same_bits(used(now, EVERYBODY), out)
    other = fresh(replace(now, raster=earlier.raster), EVERYBODY)
    assert not any(np.array_equal(other.mean[row], out.mean[row]) for row in EVERYBODY if row not in range(8, 13))


@pytest.mark.parametrize("name", GRAPHS)
def test_graphs_answer_with_the_manoeuvre_that_is_asked_for(name: str) -> None:
    graph, one = network(name), np.array([3])
    assert isinstance(graph, NetworkOfManeuvers)
    usual = graph(scene(20), one)
    best = int(usual.maneuver.argmax())
    assert_same_bits(graph.of_maneuver(scene(20), one, best), usual)
    means = [graph.of_maneuver(scene(20), one, maneuver).mean for maneuver in range(len(MANEUVERS))]
    assert len({mean.tobytes() for mean in means}) == len(MANEUVERS)


def test_a_process_that_only_predicts_imports_no_torch() -> None:
    done = subprocess.run([sys.executable, "-c", PREDICTS], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("default []", "")


def test_weights_of_a_known_architecture_are_run_by_its_graph(tmp_path: Path) -> None:
    mine = tmp_path / "mine.safetensors"
    shutil.copy(weights_path("paper"), mine)
    assert_same_bits(network(str(mine))(scene(5), np.arange(5)), network("paper")(scene(5), np.arange(5)))
    assert not np.array_equal(
        network("default")(scene(5), np.arange(5)).mean, network("paper")(scene(5), np.arange(5)).mean
    )


def test_bad_files_are_told_in_one_line(tmp_path: Path) -> None:
    scenario = Scenario.load("demo")
    garbage = tmp_path / "garbage.onnx"
    garbage.write_bytes(b"no graph at all")
    cut = tmp_path / "cut.onnx"
    cut.write_bytes((packaged("graphs") / "paper.onnx").read_bytes()[:5000])
    weights = tmp_path / "cut.safetensors"
    weights.write_bytes(weights_path("paper").read_bytes()[:5000])
    for file, named in (
        (tmp_path / "none.onnx", "no such graph"),
        (garbage, "expected an ONNX file"),
        (cut, "expected an ONNX file"),
        (packaged("graphs") / "paper.onnx", "expected an ONNX file"),  # its weights are elsewhere
        (weights, "damaged weights"),
        (tmp_path / "none.safetensors", "no such weights"),
    ):
        with pytest.raises(InputError, match=named) as caught:
            make_predictor(str(file), scenario)
        assert str(file) in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(InputError, match="expected one of bat, cs_lstm, default, kinematic, "):
        make_predictor("fast", scenario)
