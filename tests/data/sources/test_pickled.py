"""Pickles are read as plain data: nothing in them is executed, whatever they ask for."""

import pickle
import struct
from collections import OrderedDict, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import made_sources
from litsim_data.maps.lane_graph import LaneGraph
from litsim_data.sources.pickled import Opaque, read_pickle
from litsim_data.sources.scenario_net import ScenarioNet
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.load import load_recording


class Touch:
    """Makes a file as it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def written(folder: Path, content: bytes) -> Path:
    path = folder / "made.pkl"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("protocol", range(2, 6))
def test_plain_data(tmp_path: Path, protocol: int) -> None:
    given = {
        "numbers": [1, -2.5, 10**12, True, None, (3, "four")],
        "flat": np.arange(6, dtype=">f4").reshape(2, 3),
        "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "empty": np.zeros((0, 2)),
        "truths": np.array([True, False]),
        "texts": np.array(["a", "bcd"]),
        "one": np.float32(0.5),
        "bytes": b"\x00\xff",
        "dicts": [defaultdict(int, a=1), OrderedDict(b=2)],
    }
    made = read_pickle(written(tmp_path, pickle.dumps(given, protocol=protocol)))
    assert {*made} == {*given}
    for name, value in given.items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(made[name], value)
            assert made[name].shape == value.shape and made[name].dtype.kind == value.dtype.kind
        else:
            assert made[name] == value, name


def test_nothing_is_executed(tmp_path: Path) -> None:
    mark = tmp_path / "executed"
    content = read_pickle(
        written(tmp_path, pickle.dumps({"a": Touch(mark), "objects": np.array([Touch(mark)]), "b": 2}))
    )
    assert not mark.exists()
    assert isinstance(content["a"], Opaque) and isinstance(content["objects"], Opaque) and content["b"] == 2


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x80\x04",
        b"\x80\x04.",
        b"\x80\x04]h\x07.",  # of the memo, which is empty
        b"\x80\x04]e.",  # without a mark
        b"\x80\x04(" + b"t(" * 10,
        b"\x80\x04\x8e" + struct.pack("<Q", 2**62) + b".",
        b"\x80\x04\x8b" + struct.pack("<i", -5) + b".",
        b"\x80\x04]" + b"0]" * 3_000_000 + b".",
        b"\x80\x04]" + b"".join(b"q%c0](h%ch%ce" % (i, i, i) for i in range(40)) + b".",
        b"\x80\x04]q\x00h\x00a.",  # within itself
        b"\x80\x04]r\xff\xff\xff\xff.",  # remembered at a place beyond all others
        b"\x80\x04)" + b"\x85" * 100_000 + b".",
        b"\x80\x04)" + b"\x85" * 100_000 + b")\x93.",
        pickle.dumps(np.arange(9)).replace(b"K\x09\x85", b"J\xff\xff\xff\x7f\x85"),
    ],
)
def test_pickles_that_are_none(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(InputError, match=r"made.pkl: not a readable pickle: \w+ "):
        read_pickle(written(tmp_path, content))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: content.pop("metadata"), "KeyError 'metadata'"),
        (lambda content: content["tracks"].clear(), "ValueError no tracks of road users"),
        (lambda content: content["tracks"]["1"]["state"].update(valid=np.ones(5)), "ValueError track 1: 5 and "),
        (
            lambda content: content["tracks"].update(dict.fromkeys(range(300_000), "track")),
            "ValueError rows",
        ),
        (lambda content: content["map_features"]["e0"].update(polyline=3), "TypeError "),
        (lambda content: content["map_features"].update(e0=None), "AttributeError "),
    ],
)
def test_scenes_with_defects(tmp_path: Path, change: Any, message: str) -> None:
    path = made_sources.scenario_net(tmp_path / "made.pkl")
    content = pickle.loads(path.read_bytes())
    change(content)
    path.write_bytes(pickle.dumps(content))
    with pytest.raises(InputError, match=rf"made.pkl: not a scene in ScenarioNet's layout: {message}"):
        next(ScenarioNet().read(path, None))


def test_lanes_whose_names_sumo_does_not_take(tmp_path: Path) -> None:
    path = made_sources.scenario_net(tmp_path / "made.pkl", "pg")
    content = pickle.loads(path.read_bytes())
    content["map_features"]["('>', '>>', 0)"] = content["map_features"].pop("e1")
    content["map_features"]["e0"]["exit_lanes"] = ["('>', '>>', 0)", "gone"]
    path.write_bytes(pickle.dumps(content))
    (scene,) = ScenarioNet().read(path, None)
    assert scene.lanes is not None
    graph = scene.lanes()
    assert isinstance(graph, LaneGraph)
    (across,) = graph.by_id["e0"].successors
    assert across.startswith("lane") and graph.by_id[across].successors == ("e2",)


def test_the_licence_is_that_of_the_data_set(tmp_path: Path) -> None:
    recording = load_recording(made_sources.scenario_net(tmp_path / "made.pkl", "nuscenes", protocol=2))
    assert recording.header.licence == "CC BY-NC-SA 4.0" and "nuScenes" in recording.header.source
