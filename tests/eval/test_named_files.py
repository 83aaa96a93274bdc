"""Paths that users name are opened in one way: no reader waits for a pipe, reads a device, or fills the memory."""

import gzip
import os
import re
import signal
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import made_sources
from litsim_data.generic.draft import draft
from litsim_data.generic.mapping import Mapping
from litsim_data.maps.positions import positions_of
from litsim_data.mining.signals import signal_plans
from litsim_data.ngsim.reading import layout_of
from litsim_data.sources.argoverse import read_lanes
from litsim_data.sources.importing import Options, files_of, import_all
from litsim_data.sources.protobuf import records
from litsim_data.sources.sumo import vehicle_types
from litsim_eval.campaign.suite import Suite
from litsim_predictor.inference.compiled import CompiledNetwork
from litsim_predictor.inference.weights import read_weights
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.io import input_files
from litsim_sim.io.input_files import read_json
from litsim_sim.io.parquet_input import read_arrow
from litsim_sim.io.table_input import TableFile
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.run import read_run
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.scenario import Scenario, packaged
from litsim_sim.scenario.signals import read_signals


def scenario_with(field: str, path: Path) -> Scenario:
    """Loads the demo with `path` in one of its fields."""
    return Scenario.load(packaged("scenarios/demo.yaml"), **{field: str(path)})


def imported(path: Path, lanes: Path | None = None) -> Any:
    """Imports the data set at `path`; what it says of the first that is not used is raised."""
    for scene in import_all(files_of(path), path.parent / "out", Options(lanes)):
        if isinstance(scene, str):
            raise InputError(scene)


def imported_on(path: Path) -> None:
    """Imports a data set with `path` as its map."""
    imported(made_sources.argoverse(path.parent / "av2"), path)


def imported_beside(path: Path) -> None:
    """Imports a data set with `path` in place of the map beside it."""
    folder = made_sources.argoverse(path.parent / "av2")
    path.replace(folder / "log_map_archive_made.json")
    imported(folder)


READERS: dict[str, Callable[[Path], Any]] = {
    "scenario": Scenario.load,
    "recording of a scenario": lambda path: scenario_with("recording", path),
    "net of a scenario": lambda path: scenario_with("net", path),
    "signals of a scenario": lambda path: scenario_with("signals", path),
    "signals": read_signals,
    "mapping": lambda path: read_yaml(path, Mapping),
    "suite": Suite.load,
    "recording": load_recording,
    "draft": lambda path: draft([path]),
    "official NGSIM": layout_of,
    "table": TableFile.open,
    "Parquet": read_arrow,
    "net": LaneMap.from_net,
    "signal plans": signal_plans,
    "positions": positions_of,
    "import": imported,
    "map of an import": imported_on,
    "map beside an import": imported_beside,
    "map of Argoverse": read_lanes,
    "TFRecord": lambda path: list(records(path)),
    "bag of a run": read_run,
    "graph": CompiledNetwork,
    "weights": lambda path: read_weights(str(path)),
} | {
    f"map of {name}": lambda path, name=name: plugins.load(plugins.MAPS, name)().write_net(
        path, (49.0, 8.4), path.parent / "out.net.xml"
    )
    for name in plugins.names(plugins.MAPS)
}

BOMBS: dict[str, tuple[str, bytes, Callable[[Path], Any]]] = {
    "table": ("a.csv.gz", b"a,b\n" + b"1,2\n" * 10**6, lambda path: TableFile.open(path).read(["a"])),
    "table by another name": ("a.csv", b"a,b\n" + b"1,2\n" * 10**6, lambda path: TableFile.open(path).read(["a"])),
    "net": ("a.net.xml", b'<net version="1.20">' + b" " * 10**7, LaneMap.from_net),
    "signal plans": ("a.net.xml.gz", b'<net version="1.20">' + b" " * 10**7, signal_plans),
    "net of an import": ("a.net.xml.gz", b'<net version="1.20">' + b" " * 10**7, imported_on),
    "JSON": ("a.json.gz", b"[" + b" " * 10**7, lambda path: read_json(path, "a map")),
    "scenario": ("a.yaml", b"name: a" + b" " * 10**7, Scenario.load),
    "TFRecord": ("a.tfrecord", (struct.pack("<Q", 10**7) + bytes(10**7)), lambda path: list(records(path))),
    "SUMO's trajectories": ("fcd.xml.gz", b"<fcd-export>" + b" " * 10**7, imported),
    "CommonRoad": ("a.xml", b"<commonRoad>" + b" " * 10**7, imported),
} | {
    f"map of {name}": ("a.xml.gz", b"<a>" + b" " * 10**7, READERS[f"map of {name}"])
    for name in plugins.names(plugins.MAPS)
}


@pytest.fixture
def _soon() -> Iterator[None]:
    """Ends a test that waits for a pipe, or reads on and on."""

    def end(*_: object) -> None:
        raise TimeoutError("the reader waits, or reads without end")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("_soon")
@pytest.mark.parametrize("kind", ["pipe", "device", "link to a pipe"])
@pytest.mark.parametrize("name", READERS)
def test_what_is_no_file_is_refused_by_every_reader(name: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.fcd"
    if kind == "device":
        path.symlink_to("/dev/zero")
    else:
        os.mkfifo(tmp_path / "pipe")
        path.symlink_to(tmp_path / "pipe") if kind.startswith("link") else (tmp_path / "pipe").rename(path)
    with pytest.raises(InputError, match="is a device, pipe or socket, expected a file") as error:
        READERS[name](path)
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


@pytest.mark.usefixtures("_soon")
@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_that_is_large_unpacked_is_refused_by_every_reader(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, content, read = BOMBS[name]
    path = tmp_path / file
    path.write_bytes(gzip.compress(content, 1))
    monkeypatch.setattr(input_files, "UNPACKED_MIN", 10**6)
    monkeypatch.setattr(input_files, "SHRUNK_MAX", 10)
    with pytest.raises(InputError, match=rf"{re.escape(file)}: unpacks to more than \d+ bytes") as error:
        read(path)
    assert "\n" not in str(error.value)


@pytest.mark.usefixtures("_soon")
def test_pipes_beside_a_data_set_are_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "types.xml")
    (tmp_path / "more.xml").write_text('<routes><vType id="van" length="6"/></routes>')
    assert vehicle_types(tmp_path)["van"] == ("car", 6.0, 1.8)


def test_json_that_is_nested_without_end_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[" * 10**6)
    with pytest.raises(InputError, match=r"a\.json: nested deeper than can be read, expected a map$"):
        read_json(tmp_path / "a.json", "a map")
