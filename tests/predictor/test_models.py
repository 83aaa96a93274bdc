"""Predictors by name or file: who runs them, and what is told where nobody can."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from litsim_predictor import models
from litsim_predictor.inference.compiled import CompiledNetwork
from litsim_predictor.inference.weights import FORMAT, Weights, read_weights
from litsim_predictor.models import PredictorConfig, known_model, model_names, network, weights_on
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import packaged
from made_agents import scene


def written(weights: Weights, path: Path) -> str:
    """The name of a file with these weights."""
    told = {"format": FORMAT, "provenance": json.dumps(vars(weights.provenance))}
    save_file(dict(weights.arrays), path, told)
    return str(path)


def test_names_and_files_are_known() -> None:
    assert PredictorConfig().model in model_names()
    for name in (*model_names(), "mine.onnx", "folder/mine.safetensors"):
        assert known_model(name) == name
    with pytest.raises(ValueError, match=r"expected one of bat, .*, or a file \*\.safetensors or \*\.onnx"):
        known_model("mine.pt")


def test_default_alone_has_weights_of_its_own_on_streets() -> None:
    street, motorway = (LaneMap.from_net(packaged(f"nets/{name}.net.xml")) for name in ("urban_like", "us101"))
    chosen = [weights_on("default", net) for net in (street, motorway, None)]
    assert chosen == ["streets", "default", "default"] and weights_on("bat", street) == "bat"
    states = [network(name)(scene(5), np.arange(5)).mean for name in ("streets", "default")]
    assert not np.allclose(*states)


def test_weights_of_ones_own_are_compiled_where_the_model_is_a_shipped_one(tmp_path: Path) -> None:
    shipped = read_weights("cs_lstm")
    halved = replace(shipped, arrays={name: np.float32(0.5) * array for name, array in shipped.arrays.items()})
    assert isinstance(network(written(halved, tmp_path / "mine.safetensors")), CompiledNetwork)


def test_weights_without_a_graph_need_torch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = read_weights("cs_lstm")
    other = replace(shipped, provenance=replace(shipped.provenance, parameters={"encoder": 32}))
    name = written(other, tmp_path / "other.safetensors")
    monkeypatch.setattr(models.plugins, "installed", lambda _: {})
    with pytest.raises(InputError, match="need a package that runs them") as caught:
        network(name)
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_weights_that_do_not_fit_their_model_are_refused(tmp_path: Path) -> None:
    shipped = read_weights("cs_lstm")
    first = next(iter(shipped.arrays))
    cut = replace(shipped, arrays={**shipped.arrays, first: shipped.arrays[first][:1]})
    with pytest.raises(InputError, match=f"weights {first} have shape"):
        network(written(cut, tmp_path / "cut.safetensors"))
    fewer = replace(shipped, arrays={name: a for name, a in shipped.arrays.items() if name != first})
    with pytest.raises(InputError, match=f"'{first}'.* are missing"):
        network(written(fewer, tmp_path / "fewer.safetensors"))
    wild = replace(shipped, arrays={**shipped.arrays, first: shipped.arrays[first] * np.float32(np.nan)})
    with pytest.raises(InputError, match=f"weights {first} hold values that are not finite"):
        network(written(wild, tmp_path / "wild.safetensors"))


@pytest.mark.parametrize(("kind", "type_"), [("default", np.float64), ("cs_lstm", np.int32)])
def test_weights_of_another_precision_are_refused(tmp_path: Path, kind: str, type_: type) -> None:
    shipped = read_weights(kind)
    other = replace(shipped, arrays={name: array.astype(type_) for name, array in shipped.arrays.items()})
    with pytest.raises(InputError, match=rf"mine.safetensors: weights .* are of type {type_.__name__}, expected"):
        network(written(other, tmp_path / "mine.safetensors"))


def default_with(parameters: object, path: Path) -> str:
    """The name of a file with the default model's weights, and with `parameters` in its metadata."""
    shipped = read_weights("default")
    told = {"format": FORMAT, "provenance": json.dumps(vars(shipped.provenance) | {"parameters": parameters})}
    save_file(dict(shipped.arrays), path, told)
    return str(path)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("neighbours", -1, "a whole number of at least 0"),
        ("neighbours", 3.5, "a whole number of at least 0"),
        ("heads", 0, "a whole number of more than 0"),
        ("heads", 7, "a divisor of 160"),
        ("heads", "8", "a whole number of more than 0"),
        ("layers", 0, "a whole number of more than 0"),
        ("reach", -1.0, r"a number of more than 0 and at most 10000 \[m\]"),
        ("reach", "far", r"a number of more than 0 and at most 10000 \[m\]"),
        ("traffic", 2, "true or false"),
        ("map_width", None, "a whole number of more than 0"),
    ],
)
def test_parameters_that_no_model_can_have_are_refused(tmp_path: Path, name: str, value: object, expected: str) -> None:
    parameters = read_weights("default").provenance.parameters | {name: value}
    with pytest.raises(InputError, match=f"field parameters: {name} is {value!r}, expected {expected}") as caught:
        network(default_with(parameters, tmp_path / "mine.safetensors"))
    assert str(caught.value).startswith(f"{tmp_path}/mine.safetensors: ") and "\n" not in str(caught.value)


def test_parameters_that_are_no_mapping_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"metadata provenance: parameters is \[\], expected") as caught:
        network(default_with([], tmp_path / "mine.safetensors"))
    assert "\n" not in str(caught.value)


def test_as_many_neighbours_as_there_are_other_agents_are_enough(tmp_path: Path) -> None:
    parameters = read_weights("default").provenance.parameters
    few, many = (
        network(default_with(parameters | {"neighbours": count}, tmp_path / f"{count}.safetensors"))
        for count in (9, 10**12)
    )
    inputs, asked = scene(10), np.arange(10)
    assert np.array_equal(few(inputs, asked).mean, many(inputs, asked).mean)
