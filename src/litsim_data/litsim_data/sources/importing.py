"""`data import`: from recordings as they are published to LitSim's, with nets and scenarios, and the check they fit."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from litsim_data import segments
from litsim_data.generic.counts import Counts
from litsim_data.generic.description import describe
from litsim_data.generic.mapping import Check
from litsim_data.generic.si_units import CLOCK
from litsim_data.maps.alignment import share_along
from litsim_data.maps.check import NetCheck, check_net
from litsim_data.maps.check_text import describe as describe_check
from litsim_data.maps.lane_graph import LaneGraph
from litsim_data.maps.lanelet2_osm import read_graph
from litsim_data.maps.net_builder import BuiltNet, write_graph
from litsim_data.maps.net_cropping import cropped_to_net
from litsim_data.maps.netconvert import import_opendrive, is_left_hand
from litsim_data.maps.opendrive_lanes import has_both_rules, read_lanes
from litsim_data.maps.positions import vehicles_of
from litsim_data.sources.autoware_bag import METADATA_FILE
from litsim_data.sources.conversion import converted
from litsim_data.sources.source import Scene, Source, known_sources, source_of
from litsim_sim.core.errors import InputError, reason
from litsim_sim.core.scene import RATE_HZ, STEP_S
from litsim_sim.io.files import make_folder, replacing
from litsim_sim.io.input_files import TREE_MAX, open_input, require_file
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.checks import DRIVING
from litsim_sim.scenario.cropping import Crop
from litsim_sim.scenario.load import OTHER_TABLES
from litsim_sim.scenario.recorded_net import NET_ENDINGS, net_of
from litsim_sim.scenario.recorded_signals import survey
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.signals import SignalsFile, on_clock, resolved

SHORT_S = 28.1  # [s] recordings that are shorter become one scenario each
NOTES = 8  # most lines on a map that are shown
HISTORY_SHARE, EGO_SHARE = 0.25, 0.6  # of a shorter recording; of the time after its history, that an ego is there


@dataclass
class Net:
    """A net that was written.

    Attributes:
        path: its file.
        lane_map: its lanes.
        graph, built: the lane graph that it was built from; None where it was not.
        opendrive: the OpenDRIVE map that it was built from, until its side has been compared with tracks.
        notes: sentences about parts of the map that were not used, emptied once they are printed.
    """

    path: Path
    lane_map: LaneMap
    graph: LaneGraph | None = None
    built: BuiltNet | None = None
    opendrive: Path | None = None
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Options:
    """What users say of an import.

    Attributes:
        lanes: the map, where it is not in the data or beside; a net cuts the tracks to its lanes.
        crop: the [low, high] to keep, by column of the tracks.
        raw: whether noisy motion is kept.
        accept: checks to skip.
    """

    lanes: Path | None = None
    crop: Crop | None = None
    raw: bool = False
    accept: Sequence[Check] = ()


@dataclass(frozen=True)
class Imported:
    """A scene that was imported.

    Attributes:
        name: its name.
        recording, path: the recording, and its file.
        net: its net; None where there is no map.
        counts: of the conversion.
        check: how the recording lies on the net.
        signals: number of lights whose states it carries.
        lines: text on all of that.
        seconds: time that it took [s].
    """

    name: str
    recording: Recording
    path: Path
    net: Net | None
    counts: Counts
    check: NetCheck | None
    signals: int
    lines: list[str]
    seconds: float

    @property
    def row(self) -> str:
        """A line of the table of all scenes."""
        vehicles = len(np.unique(self.recording.columns["vehicle_id"]))
        on_lanes = "-" if self.check is None else f"{next(iter(self.check.placements.values())).inside:.1%}"
        return (
            f"{self.name:<40.40}{self.counts.read:>9}{vehicles:>10}{on_lanes:>11}{self.signals:>9}{self.seconds:>9.1f}"
        )


HEAD = f"{'scene':<40}{'rows in':>9}{'vehicles':>10}{'on lanes':>11}{'signals':>9}{'seconds':>9}"


def files_of(path: Path) -> list[tuple[Path, Source]]:
    """Returns the recordings in a file or folder, with their sources; a bag that is a folder is one.

    Raises:
        InputError: there is no such file or folder, or nothing in it is known.
    """
    if not path.is_dir():
        require_file(path, "recording")
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    if path.is_dir():
        files = [file for file in files if file.name == METADATA_FILE or not (file.parent / METADATA_FILE).is_file()]
    recognised = [(file, source) for file in files if (source := source_of(file)) is not None]
    if not recognised:
        contents = "; ".join(source.content for source in known_sources())
        held = f"none of its {len(files)} files is" if path.is_dir() else "is not"
        raise InputError(f"{path}: {held} of a known format: {contents}; {OTHER_TABLES}")
    return recognised


def import_all(
    files: Sequence[tuple[Path, Source]], out: Path, options: Options, most: int | None = None
) -> Iterator[Imported | str]:
    """Imports the scenes in `files` into the folder `out`; yields each, or a line on why it could not be used.

    Args:
        files: files with their sources.
        out: the folder, which is made.
        options: what users say of it.
        most: most scenes that are imported; None for all.

    Raises:
        InputError: `out` cannot be written.
    """
    nets: dict[str, Net | None] = {}
    names: set[str] = set()
    make_folder(out)
    count = 0
    with tqdm(files, unit=" files", leave=False, disable=None) as bar:
        for file, source in bar:
            try:
                for scene in source.scenes(file, options.lanes, options.crop):
                    if most is not None and count >= most:
                        return
                    count += 1
                    try:
                        yield _import_scene(_named_apart(scene, names), source, out, nets, options)
                    except InputError as error:
                        yield reason(error)
            except InputError as error:
                yield reason(error)


def import_alone(scene: Scene, source: Source, out: Path, options: Options) -> list[str]:
    """Writes the recording of a scene to the file `out`, and what lights showed beside; returns lines on it.

    Raises:
        InputError: the scene cannot be used, no vehicle comes onto the net, or `out` cannot be written.
    """
    recording, counts = converted(scene, source, raw=options.raw, accept=options.accept)
    cut: list[str] = []
    if options.lanes is not None:
        recording, cut = _cropped(recording, LaneMap.from_net(options.lanes), str(scene.tracks), options.lanes.name)
    recording, heeded = _with_signals_file(scene, recording, out)
    recording.write(out)
    lines = [describe(recording), counts.text(), *cut, *heeded, *(f"note       {note}" for note in scene.notes)]
    if scene.signals:
        changes = out.with_name(f"{out.stem}_signals.csv")
        with replacing(changes) as new:
            pd.DataFrame(scene.signals, columns=["begin", "group", "state"]).to_csv(new, index=False)
        lines.append(f"{'signals':<11}{len(scene.signals)} changes -> {changes}")
    return lines


def _named_apart(scene: Scene, names: set[str]) -> Scene:
    """Returns a scene under a name that is not among `names`, and adds it there."""
    name, number = scene.name, 1
    while name in names:
        number += 1
        name = f"{scene.name}_{number}"
    names.add(name)
    return replace(scene, name=name, map_name=name if scene.map_name == scene.name else scene.map_name)


def _import_scene(scene: Scene, source: Source, out: Path, nets: dict[str, Net | None], options: Options) -> Imported:
    """Imports a scene: see :func:`import_all`.

    Raises:
        InputError: it cannot be used.
    """
    begin = time.monotonic()
    map_name = scene.map_name or scene.name
    if map_name not in nets:
        nets[map_name] = _net(scene, map_name, out, options.lanes)
    net, path = nets[map_name], out / f"{scene.name}.parquet"
    keeps_left = net is not None and net.graph is not None and net.graph.keeps_left
    accept: list[Check] = [*options.accept, "side"] if keeps_left else [*options.accept]
    recording, counts = converted(scene, source, raw=options.raw, accept=accept)
    lines: list[str] = []
    signals, check = 0, None
    if net is not None:
        if net.opendrive is not None:
            net = nets[map_name] = _on_its_side(net, recording)
        recording, lines = _cropped(recording, net.lane_map, str(scene.tracks), map_name)
        recording = Recording(replace(recording.header, net=net.path.name), recording.columns)
        recording, signals, heeded = _with_signals(scene, recording, net)
        lines += heeded
    recording, heeded = _with_signals_file(scene, recording, path)
    recording.write(path)
    lines = [describe(recording), counts.text(), *lines, *heeded, *(f"note       {note}" for note in scene.notes)]
    if net is not None:
        check, picture = _check(recording, net, path.with_suffix(".png"))
        lines += [f"map        {note}" for note in net.notes[:NOTES]]
        lines += [f"map        and {len(net.notes) - NOTES} more such lines"] if len(net.notes) > NOTES else []
        lines += [describe_check(check), f"picture    {picture}"]
        net.notes.clear()
    return Imported(scene.name, recording, path, net, counts, check, signals, lines, time.monotonic() - begin)


def _cropped(recording: Recording, lane_map: LaneMap, tracks: str, net: str) -> tuple[Recording, list[str]]:
    """Returns the recording, cut to where lanes are, and lines on what was left out.

    Raises:
        InputError: nothing is left.
    """
    recording, lines = cropped_to_net(recording, lane_map)
    if not len(recording.columns["frame"]):
        raise InputError(f"{tracks}: no vehicle comes onto a lane of {net}: data map --check shows why")
    return recording, lines


def _net(scene: Scene, name: str, out: Path, named: Path | None) -> Net | None:
    """Writes the net of a scene; None where there is no map."""
    path = out / f"{name}.net.xml"
    lanes: LaneGraph | Path
    if named is not None and (named.name.endswith((*NET_ENDINGS, ".xodr")) or scene.lanes is None):
        lanes = named
    elif scene.lanes is not None:
        lanes = scene.lanes()
    else:
        return None
    if isinstance(lanes, Path) and lanes.suffix == ".osm":
        lanes = read_graph(lanes, None)
    if isinstance(lanes, Path) and lanes.suffix == ".xodr" and has_both_rules(lanes):
        lanes = read_lanes(lanes)
    if isinstance(lanes, LaneGraph):
        built = write_graph(lanes, path)
        return Net(path, LaneMap.from_net(path), lanes, built, notes=[*built.notes])
    if lanes.suffix == ".xodr":
        notes = import_opendrive(lanes, path)
        return Net(path, LaneMap.from_net(path), opendrive=lanes, notes=notes)
    with replacing(path) as new, open_input(lanes, "net", size_max=TREE_MAX) as file:
        new.write_bytes(file.read())
    return Net(path, LaneMap.from_net(path))


def _on_its_side(net: Net, recording: Recording) -> Net:
    """Returns the net of an OpenDRIVE map on the side that the tracks keep to, which some files say wrongly."""
    source = net.opendrive
    assert source is not None
    net.opendrive = None  # compared once
    table = recording.table[recording.table["speed"] > DRIVING]
    poses = [table[name].to_numpy() for name in ("x", "y", "yaw")]
    along = share_along(net.lane_map, *poses) if len(table) else 1.0
    if along >= 0.5:
        return net
    to_left = not is_left_hand(net.path)
    other = net.path.with_name(f"other.{net.path.name}")
    notes = import_opendrive(source, other, left_hand=to_left)
    lane_map = LaneMap.from_net(other)
    if share_along(lane_map, *poses) <= along:
        other.unlink()
        return net
    other.replace(net.path)
    side = "left" if to_left else "right"
    notes.append(f"{source.name}: the tracks keep to the {side}, and so does the net, other than the file says")
    return Net(net.path, lane_map, notes=notes)


def _with_signals(scene: Scene, recording: Recording, net: Net) -> tuple[Recording, int, list[str]]:
    """Returns the recording with the signals of the scene, the number of lights that they are of, and lines on them."""
    if not scene.signals or net.graph is None or net.built is None:
        return recording, 0, []
    held = net.built.controlled(net.graph)
    shown = {light for _, light, _ in scene.signals}
    groups = {light: held.get(light, []) for light in sorted(shown)}
    count = sum(bool(members) for members in groups.values())
    if not count:
        return recording, 0, [f"signals    left out: no lane of the net is held by one of the {len(shown)} lights"]
    zero = float(str(recording.header.notes.get(CLOCK, 0.0)))
    content = on_clock(SignalsFile.model_validate({"groups": groups, "changes": list(scene.signals)}), zero)
    try:
        recording, lines = _carrying(content, recording, net.path, str(scene.tracks))
    except InputError as error:
        return recording, 0, [f"signals    left out: {reason(error)}"]
    return recording, count, lines


def _with_signals_file(scene: Scene, recording: Recording, path: Path) -> tuple[Recording, list[str]]:
    """Returns the recording, of the file `path`, with the signals of a file, and lines on how vehicles heed them.

    Frames of a file of states are those of the table, where it counts frames, and else those of the recording.

    Raises:
        InputError: the signals cannot be used, do not fit the net, or are not what vehicles heed; or there is no net.
    """
    file, mapping = scene.signals_file, scene.mapping
    if file is None or mapping is None:
        return recording, []
    signals = read_yaml(file, SignalsFile)
    by_frame = signals.states is not None and signals.states.unit == "frame"
    zero = 0.0 if by_frame else float(str(recording.header.notes.get(CLOCK, 0.0)))
    slower = recording.header.rate_hz / mapping.rate_hz if by_frame and mapping.columns.frame is not None else 1.0
    content = on_clock(resolved(signals, file.parent, str(file)), zero, slower)
    return _carrying(content, recording, net_of(recording.header, path), str(file))


def _carrying(content: SignalsFile, recording: Recording, net: Path, where: str) -> tuple[Recording, list[str]]:
    """Returns the recording with signals of its net in the header, and lines on how vehicles heed them.

    Raises:
        InputError: the signals do not fit the net or the recording; `where` names them.
    """
    lines = survey(content, net, recording, where)
    header = replace(recording.header, net=net.name, signals=content.model_dump(mode="json", exclude_none=True))
    return Recording(header, recording.columns), lines


def _check(recording: Recording, net: Net, picture: Path) -> tuple[NetCheck, Path]:
    """Checks how the vehicles that are on the road lie on the net, and draws it."""
    from litsim_data.pictures.map_picture import draw  # matplotlib takes half a second to load

    table = vehicles_of(recording.table, recording.header.name)
    inside = net.lane_map.inside_road(table["x"].to_numpy(), table["y"].to_numpy())
    on_road = pd.Series(inside, table.index).groupby(table["vehicle_id"]).transform("any")
    parts = {"recording": table[on_road] if on_road.any() else table}
    check = check_net(net.path, parts)
    draw(picture, net.lane_map, parts, check)
    return check, picture


def cut(imported: list[Imported], out: Path) -> segments.Manifest:
    """Cuts the recordings into scenarios, which are written into the folder `out`; returns their manifest.

    Recordings of SHORT_S and less become one scenario each, with as much history as the shortest of them allows.

    Raises:
        InputError: no vehicle can be the ego.
    """
    frames = [part.recording.columns["frame"] for part in imported]
    shortest = min(int(frame.max() - frame.min()) for frame in frames) * STEP_S
    values: dict[str, Any] = {"split": (1.0, 0.0, 0.0)}
    if shortest < SHORT_S:
        history = max(round(HISTORY_SHARE * shortest * RATE_HZ) * STEP_S, STEP_S)
        values["history_s"] = round(min(history, 3.0), 1)
        values["simulation_s"] = round(min(25.0, max(shortest - values["history_s"], STEP_S)), 1)
        values["ego_min_s"] = round(max(EGO_SHARE * values["simulation_s"], STEP_S), 1)
    sources = [
        (f"../{part.path.name}", f"../{part.net.path.name}", None, part.recording) for part in imported if part.net
    ]
    manifest = segments.cut(sources, segments.Settings(**values))
    segments.write(manifest, out)
    return manifest
