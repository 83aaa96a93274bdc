"""Scenarios: a part of a recording on a net, with an ego."""

from __future__ import annotations

import copy
import logging
import os
import re
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, IntArray
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.io.input_files import require_file
from litsim_sim.io.yaml_input import parse_yaml, read_text, validate_yaml
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.changes import Act, Delay, SignalsLater, acts, changed_recording, shifted_frames
from litsim_sim.scenario.checks import Demand, UnmetDemandError, check_agents, check_changes, check_coverage, check_goal
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.log_overlaps import LogOverlaps
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario_file import ScenarioFile
from litsim_sim.scenario.signal_conflicts import green_conflicts
from litsim_sim.scenario.signals import Signals, SignalsFile, build, check_known, on_clock, read_signals, resolved

DATA_VARIABLE = "LITSIM_DATA"
NO_DATA = "(scenario demo needs none; docs/data.md: NGSIM's own files in its place)"
PACKAGE = "litsim_sim"

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Sources:
    """A recording and its net in memory, to be shared by several scenarios."""

    recording: Recording
    lane_map: LaneMap


class Scenario:
    """A checked scenario with its recording and log in memory.

    Steps of 0.1 s run from 0 to `total_steps`; those below `history_steps` are the recorded past.

    Agents on roads that pass over or under that of the ego, with no way between them, are left out.

    Attributes:
        file: the resolved fields, with absolute paths.
        recording: the recording, without its changes, cut to the frames of the scenario.
        log: the recording with its changes, as dense arrays.
        start_frame: frame of step 0.
        history_steps: step from which on the ego is free.
        total_steps: the last step.
        signals: states of the signals at each step; None if unknown.
        shortened: whether the recording ends before `simulation_s` have passed.
        coverage: share of the recorded box centres that lie on lanes of the net.
    """

    def __init__(self, file: ScenarioFile, where: str, sources: Sources | None = None) -> None:
        """Read and check all files that `file`, with resolved paths, names; `sources` are those that are read already.

        Raises an InputError, in which `where` names the scenario file, if a file or its content cannot be used;
        an :class:`UnmetDemandError` if the fields do not fit the recording, or the net does not.
        """
        self.net_path = Path(file.net)
        if sources is not None:
            self.lane_map = sources.lane_map
        recording = load_recording(Path(file.recording), file.crop) if sources is None else sources.recording
        frames = recording.columns["frame"]
        first, last = int(frames.min()), int(frames.max())
        self.start_frame = first if file.start_frame is None else file.start_frame
        if not first <= self.start_frame <= last:
            raise UnmetDemandError(
                Demand.LENGTH, f"{where}: start_frame is {file.start_frame}, expected one of {first} to {last}"
            )
        self.file = file.model_copy(update={"start_frame": self.start_frame})
        self.history_steps = round(file.history_s / STEP_S)
        wanted = self.history_steps + round(file.simulation_s / STEP_S)
        self.total_steps = min(wanted, last - self.start_frame)
        self.shortened = self.total_steps < wanted
        if self.total_steps <= self.history_steps:
            raise UnmetDemandError(
                Demand.LENGTH,
                f"{where}: the recording is too short: {last - self.start_frame} steps of {STEP_S} s follow frame "
                f"{self.start_frame}, expected more than the history of {file.history_s:g} s",
            )
        end = self.start_frame + self.total_steps
        changed_frames = shifted_frames(recording, file.changes)
        within = [(frame_range >= self.start_frame) & (frame_range <= end) for frame_range in (frames, changed_frames)]
        self.recording = recording.take(within[0] | within[1])
        changed = changed_recording(self.recording, file.changes, self.start_frame, self.history_steps)
        self.log = Log.from_recording(changed, self.start_frame, self.total_steps + 1)
        check_agents(self.file, self.log, self.history_steps, where)
        check_changes(self.file, self.log, self.history_steps, where)
        check_goal(self.file, self.log, self.lane_map, self.history_steps, where)
        self.coverage = check_coverage(self.lane_map, self.net_path, self.log, file.coverage_min, where)
        signals = self.file.signals or recorded_signals(recording.header, self.net_path, file.recording)
        self.signals: Signals | None = None
        if isinstance(signals, SignalsFile):
            later = sum(change.later_s for change in file.changes if isinstance(change, SignalsLater))
            signals = on_clock(signals, -later) if later else signals
            self.signals = build(signals, self.net_path, self.log, self.start_frame, where, as_recorded=not later)
            for sentence in green_conflicts(signals, self.signals, self.start_frame):
                _warn(f"{where}: signals: {sentence}")
            if self.file.signals:  # signals of a recording may be known for a part of it only
                shown = (self.start_frame, self.start_frame + self.total_steps)
                check_known(signals, self.signals.known, shown, where)
        self._on_all_levels = self.recording, self.log
        self._leave_out_other_levels()

    @classmethod
    def load(cls, name_or_path: str | Path, *, sources: Sources | None = None, **overrides: Any) -> Scenario:
        """Load a packaged scenario by name, such as ``demo``, or a scenario file by path.

        `overrides` replace fields of the file, such as `ego`, `seed`, `roi_m`, unless they are None; of
        `vehicle`, only the values given. `sources` are recording and net, if read already. Raises an InputError
        if the scenario does not exist, or cannot be used.
        """
        path = Path(name_or_path)
        if not path.suffix and str(path) == path.name and str(path) in packaged_scenarios():
            path = packaged(f"scenarios/{path}.yaml")
        require_file(path, "scenario", f"; expected a YAML file, or one of {', '.join(packaged_scenarios())}")
        return cls._build(read_text(path), str(path), path.resolve().parent, overrides, sources)

    @classmethod
    def from_yaml(cls, text: str, where: str) -> Scenario:
        """Build from the text of a scenario file, called `where` in errors; paths are relative to this folder."""
        return cls._build(text, where, Path.cwd(), {})

    def around(
        self, ego: int | None, seed: int | None, end_after_contact_s: float | None = None, draw: int | None = None
    ) -> Scenario:
        """Returns the scenario with another ego, seed, end and draw, unless None; recording, log and map are shared.

        Raises InputError if the ego is not present from step 0 to the first simulated step, or a value does not
        fit.
        """
        changes = {"ego": ego, "seed": seed, "end_after_contact_s": end_after_contact_s, "draw": draw}
        changes = {name: value for name, value in changes.items() if value is not None}
        file = validate_yaml(self.file.model_dump() | changes, ScenarioFile, self.name, "")
        check_agents(file, self._on_all_levels[1], self.history_steps, self.name)
        check_goal(file, self._on_all_levels[1], self.lane_map, self.history_steps, self.name)
        other = copy.copy(self)
        other.file = file
        other._leave_out_other_levels()  # noqa: SLF001 - of the same class
        return other

    def _leave_out_other_levels(self) -> None:
        """Leaves out, in place, agents that are mostly on roads that pass over or under the one of the ego."""
        levels = self.lane_map.levels
        if levels is None or not levels.over.any():
            return
        recording, log = self._on_all_levels
        agent, step = log.valid.nonzero()
        place = self.lane_map.nearest(log.x[agent, step], log.y[agent, step], log.yaw[agent, step])
        count = np.zeros((len(log.ids), len(levels.over)), np.int64)
        np.add.at(count, (agent, levels.part[place.lane]), 1)
        part = count.argmax(axis=1)
        stays = ~levels.apart_from(int(part[log.row(self.ego_id)]))[part]
        self.log = log.take(stays)
        self.recording = recording.take(~np.isin(recording.columns["vehicle_id"], log.ids[~stays]))
        for derived in ("log_overlaps", "last_logged"):
            vars(self).pop(derived, None)
        if not stays.all():
            _warn(f"{self.name}: agents on roads above or below that of ego {self.ego_id} are left out: {sum(~stays)}")

    def to_yaml(self) -> str:
        """Returns the resolved scenario, with absolute paths; :meth:`from_yaml` builds the same from it."""
        return yaml.safe_dump(self.file.model_dump(mode="json"), sort_keys=False)

    @classmethod
    def _build(
        cls, text: str, where: str, folder: Path, overrides: dict[str, Any], sources: Sources | None = None
    ) -> Scenario:
        values = parse_yaml(text, where, ScenarioFile)
        if "litsim_segments" in values:
            raise InputError(f"{where}: the manifest of a folder of segments, expected a scenario, as those beside it")
        changes = {key: value for key, value in overrides.items() if value is not None}
        if "vehicle" in changes and isinstance(values.get("vehicle"), dict):
            changes["vehicle"] = values["vehicle"] | changes["vehicle"]
        values.update(changes)
        file = validate_yaml(values, ScenarioFile, where, text)
        net = packaged(f"nets/{file.net}.net.xml") if file.net in packaged_nets() else folder / file.net
        packaged_ones = f"; expected a file, or one of {', '.join(packaged_nets())}"
        require_file(net, "net", packaged_ones, where=f"{where}: field net: ")
        resolved_fields: dict[str, Any] = {
            "recording": str(_data_path(file.recording, folder, where)),
            "net": str(net.resolve()),
        }
        if isinstance(file.signals, str):
            resolved_fields["signals"] = read_signals(folder / file.signals)
        elif file.signals is not None:
            resolved_fields["signals"] = resolved(file.signals, folder, f"{where}: field signals")
        return cls(file.model_copy(update=resolved_fields), where, sources)

    @property
    def name(self) -> str:
        """Short name of the scenario."""
        return self.file.name

    @property
    def ego_id(self) -> int:
        """Id of the vehicle that the driving system under test moves."""
        return self.file.ego

    @property
    def ego_ids(self) -> IntArray:
        """(scenes,) the same, as an array of the egos of all scenes."""
        return np.array([self.file.ego])

    @property
    def identities(self) -> IntArray:
        """(N, 2) seed of the drivers of its scene and id there of each agent of the log; they seed its random draws."""
        seed = self.seed
        if self.file.draw:
            mixed = np.random.SeedSequence((self.seed, self.file.draw)).generate_state(1, np.uint64)
            seed = int(mixed[0] >> np.uint64(1))  # ids are signed
        return np.column_stack([np.full(len(self.log.ids), seed), self.log.ids])

    @property
    def egos(self) -> tuple[int, ...]:
        """Ids of the egos of experiments; the ego alone if the file lists none."""
        return tuple(self.file.egos) or (self.file.ego,)

    @property
    def tuning_egos(self) -> tuple[int, ...]:
        """Ids of the egos on which a system may be tuned before an experiment; disjoint from `egos`."""
        return tuple(self.file.tuning)

    @property
    def possible_egos(self) -> tuple[int, ...]:
        """Ids of the vehicles that are present from step 0 to the first simulated step."""
        there = (self.log.first_step == 0) & (self.log.last_step > self.history_steps) & ~self.log.obstacle
        return tuple(self.log.ids[there].tolist())

    @property
    def actors(self) -> tuple[tuple[int, Act], ...]:
        """Ids of the agents that the changes of the scenario make actors, and what each does."""
        return tuple((act.agent, act) for act in acts(self.file.changes))

    @property
    def roi_m(self) -> float:
        """Radius around each agent off its log within which others are forecast and may be taken over [m]."""
        return self.file.roi_m

    @property
    def seed(self) -> int:
        """Seed of all randomness in a run."""
        return self.file.seed

    @property
    def steps_after_contact(self) -> tuple[int | None, ...]:
        """(scenes,) number of steps that follow the first contact of the ego; None if the run continues."""
        after = self.file.end_after_contact_s
        return (None if after is None else round(after / STEP_S),)

    @cached_property
    def vehicle(self) -> VehicleModel:
        """Vehicle model of the ego: limits and actuators."""
        later = sum(change.later_s for change in self.file.changes if isinstance(change, Delay))
        delay = {"delay_s": round(self.file.vehicle.get("delay_s", 0.0) + later, 1)} if later else {}
        return VehicleModel.of(self.file.vehicle | delay)

    @cached_property
    def log_overlaps(self) -> LogOverlaps:
        """Overlaps of boxes in the log itself."""
        return LogOverlaps(self.log)

    @cached_property
    def last_logged(self) -> IntArray:
        """(scenes,) the last step at which any agent of the scene is logged."""
        return np.array([self.log.last_step.max()])

    @cached_property
    def lane_map(self) -> LaneMap:
        """The lanes of the net, and queries on them."""
        return LaneMap.from_net(self.net_path)


@cache
def _warn(text: str) -> None:
    _log.warning(text)


def recorded_signals(header: RecordingHeader, net: Path, where: str) -> SignalsFile | None:
    """Returns the signals in the header of the recording `where` if it names this net; else warns once."""
    if not header.signals:
        return None
    if header.net != net.name:
        _warn(
            f"{where}: carries signals of net {header.net}, which are left out on {net.name}: name signals of that net"
        )
        return None
    return validate_yaml(dict(header.signals), SignalsFile, f"{where}: signals in the header", "")


def packaged(relative: str, package: str = PACKAGE) -> Path:
    """Returns the path of the file at `relative` in a package, by default this one."""
    return Path(str(resources.files(package).joinpath(relative)))


def packaged_scenarios() -> tuple[str, ...]:
    """Returns the names of the packaged scenarios, which :meth:`Scenario.load` knows, sorted."""
    return tuple(sorted(path.stem for path in packaged("scenarios").glob("*.yaml")))


def packaged_nets() -> tuple[str, ...]:
    """Returns the names of the packaged nets, which the field `net` of a scenario knows, sorted."""
    return tuple(sorted(path.name.removesuffix(".net.xml") for path in packaged("nets").glob("*.net.xml")))


def _data_path(recording: str, folder: Path, where: str) -> Path:
    """Returns the absolute path of field `recording`, with LITSIM_DATA expanded."""
    data_file = re.fullmatch(rf"\$(?:{DATA_VARIABLE}|{{{DATA_VARIABLE}}})/+(.+)", recording)
    if data_file is None:
        path = (folder / recording).resolve()
        require_file(path, "recording", where=f"{where}: field recording: ")
        return path
    relative, data = data_file[1], os.environ.get(DATA_VARIABLE, "")
    if not data:
        raise InputError(
            f"{where}: field recording: needs real data: put it into a folder as DATA/{relative} and set "
            f"{DATA_VARIABLE} to DATA {NO_DATA}"
        )
    path = (Path(data).expanduser() / relative).resolve()
    hint = f"; put the file there, or set {DATA_VARIABLE} to the folder that holds {relative} {NO_DATA}"
    require_file(path, "recording", hint, where=f"{where}: field recording: ")
    return path
