"""A recorded run as arrays, decoded from its MCAP file alone, by the message definitions in it."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property, lru_cache
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import IO, Any, TypeVar, cast

import numpy as np

from litsim_sim.core.checks import CELLS_MAX, STEPS_MAX, check_budget
from litsim_sim.core.errors import InputError
from litsim_sim.core.lockstep import marks_of
from litsim_sim.core.scene import AgentTable, ByteArray, ControlTable, EgoCommand, IntArray
from litsim_sim.core.signals import SignalState
from litsim_sim.core.stages import BRIDGE, RunEnd, StageState
from litsim_sim.core.steps import Steps, StepsBuilder, write_temporary
from litsim_sim.core.takeover import Takeover
from litsim_sim.core.topic_names import (
    AGENTS,
    CONTROLS,
    EGO_APPLIED,
    EGO_CONTROL,
    EGO_GOAL,
    EGO_ROUTE,
    LANE_TABLE,
    RUN_INFO,
    SIGNAL_MAP,
    SIGNALS,
    STATUS,
    TAKEOVERS,
    TIMING,
)
from litsim_sim.io.yaml_input import load_yaml
from litsim_sim.lane_map.signal_links import ARROW, SignalLink
from litsim_sim.record.bag import BagReader, BagTopic
from litsim_sim.record.clouds import cloud_columns
from litsim_sim.record.decoding import UNDECODABLE, decoded
from litsim_sim.record.failure import read_failure
from litsim_sim.record.seal import RunFacts, Seal, read_seal, summary_fields
from litsim_sim.scenario.log import logged_steps
from litsim_sim.scenario.mission import Mission
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.signals import Signals

DECODED = (RUN_INFO, AGENTS, SIGNAL_MAP, SIGNALS, TAKEOVERS, CONTROLS, EGO_CONTROL, EGO_APPLIED, STATUS, TIMING)
"""Topics whose messages are decoded; only the log times of others are used."""
OF_MISSION = (EGO_ROUTE, EGO_GOAL, LANE_TABLE)
"""Topics with the mission of the ego, which are decoded if a run has all of them: earlier versions had the first."""
OF_POLICY = (TAKEOVERS, CONTROLS)
"""Decoded topics that only a run with a policy has."""

MINIMUM_RISK_TYPE = "autoware_adapi_v1_msgs/msg/MrmState"
"""Type of the topic on which a stack tells the state of its minimum-risk manoeuvre, whatever its name."""

T = TypeVar("T")

RECORDING_FILE = "recording.parquet"
SCENARIO_FILE = "scenario.yaml"
NET_FILE = "net.xml"
SPOOLED_BYTES, SIZE_BYTES = 2**23, 8  # of messages by step that are in memory, else in a file; of the size of each
START_FIELD = "start_frame"  # field of the scenario: frame of the recording at step 0


@dataclass(frozen=True)
class RunInfo:
    """Description of a run; fields as in ``litsim_msgs/RunInfo``. Steps are numbered 0 to `total_steps`, inclusive; a
    run may end earlier (:attr:`Run.ended`).
    """

    run_id: str
    scenario: str
    scenario_yaml: str
    ego: str
    policy: str
    ego_id: int
    seed: int
    total_steps: int
    history_steps: int
    dt: float
    mode: str
    stages: tuple[str, ...]
    topics: tuple[str, ...]
    configuration: str
    versions: str


@dataclass(frozen=True)
class Detection:
    """End of the conflict detection of one step: rounds until nothing new was found, or up to the bound on them."""

    iterations: int
    converged: bool


@dataclass(frozen=True)
class Status:
    """A reported state of a stage; `compute_time` in seconds of wall time."""

    step: int
    stage: str
    state: StageState
    compute_time: float
    text: str


@dataclass(frozen=True)
class TopicGaps:
    """Steps of a topic that should hold exactly one message each, in ascending order."""

    missing: tuple[int, ...] = ()
    duplicated: tuple[int, ...] = ()
    unordered: tuple[int, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.missing or self.duplicated or self.unordered)

    @classmethod
    def find(cls, steps: Iterable[int], last: int) -> TopicGaps:
        """Returns the gaps of the steps of a topic's messages, in file order, against 0 .. `last`."""
        received = list(steps)
        count = Counter(received)
        highest = np.maximum.accumulate(np.array(received, np.int64))
        return cls(
            missing=tuple(k for k in range(last + 1) if k not in count),
            duplicated=tuple(sorted(k for k, n in count.items() if n > 1)),
            unordered=tuple(sorted({k for k, high in zip(received, highest.tolist(), strict=True) if k < high})),
        )


@dataclass(frozen=True)
class Run:
    """All data of a run for its analysis.

    Attributes:
        path: MCAP file.
        info: description of the run.
        tables: agents of every recorded step, steps ascending.
        log: logged agents of the same steps; empty if the bag holds no recording.
        controls: answer of the policy by step; empty if the log alone moves the background.
        ego_commands: command of the ego by step: its answer, or for an external ego the bridge's conversion of it.
        takeovers: the agents off their logs, by step.
        detections: how conflict detection ended, by step.
        timing: compute time [s] by stage and step.
        marks: clock times that each stage took while it served a step [s], by stage, step and name; see
            :mod:`litsim_eval.analysis.measures.timing`.
        minimum_risk: what the stack that drives the ego has told of its minimum-risk manoeuvre, by step: the values of
            ``autoware_adapi_v1_msgs/MrmState``, of which 1 is normal driving; empty where that is not recorded.
        statuses: reported states of all stages, in order of arrival.
        scenario_yaml: the resolved scenario.
        net_xml: the SUMO net, or empty.
        signals: states of the signals; None if the scenario has none.
        mission: mission of the ego; None if it is not recorded, as by earlier versions.
        gaps: gaps by topic, for topics that must hold one message for every step; empty entries for those without gaps.
        complete: whether the recorder closed the file.
        problem: why the file is incomplete; empty for a complete one.
        failure: why the run has failed, as written by the launcher beside the file; empty if it has not.
        seal: seal of the record; None for a run that was not recorded.
    """

    path: Path
    info: RunInfo
    tables: Sequence[AgentTable]
    log: Sequence[AgentTable] = field(default_factory=list)
    controls: Mapping[int, ControlTable] = field(default_factory=dict)
    ego_commands: Mapping[int, EgoCommand] = field(default_factory=dict)
    takeovers: Mapping[int, list[Takeover]] = field(default_factory=dict)
    detections: Mapping[int, Detection] = field(default_factory=dict)
    timing: Mapping[str, Mapping[int, float]] = field(default_factory=dict)
    marks: Mapping[str, Mapping[int, Mapping[str, float]]] = field(default_factory=dict)
    minimum_risk: dict[int, int] = field(default_factory=dict)
    statuses: list[Status] = field(default_factory=list)
    scenario_yaml: str = ""
    net_xml: bytes = b""
    signals: Signals | None = None
    mission: Mission | None = None
    gaps: dict[str, TopicGaps] = field(default_factory=dict)
    complete: bool = True
    problem: str = ""
    failure: str = ""
    seal: Seal | None = None

    @cached_property
    def steps(self) -> Steps:
        """Agents of every recorded step, in arrays over all of them."""
        return Steps.of(self.tables)

    @cached_property
    def logged(self) -> Steps:
        """Logged agents of the same steps; the same object for runs that have their log in common."""
        return Steps.of(self.log)

    def once(self, function: Callable[[Run], T]) -> T:
        """Returns the result of `function` for this run, computed once and kept with the run."""
        if function not in self._results:
            self._results[function] = function(self)
        result: T = self._results[function]
        return result

    def forget(self, function: Callable[[Run], Any]) -> None:
        """Drops what :meth:`once` has kept of `function`, if anything."""
        self._results.pop(function, None)

    @cached_property
    def _results(self) -> dict[Callable[[Run], Any], Any]:
        return {}

    @property
    def scenario(self) -> Mapping[str, Any]:
        """Fields of the resolved scenario, by name; empty without one."""
        return _scenario_fields(self.scenario_yaml or self.info.scenario_yaml)

    @property
    def simulated(self) -> Steps:
        """Agents of the steps after the history, whose motion the run decided."""
        return self.steps.after(self.info.history_steps)

    @property
    def simulated_log(self) -> Steps:
        """Logged agents of the steps of :attr:`simulated`."""
        return self.logged.after(self.info.history_steps)

    @property
    def ended(self) -> RunEnd | None:
        """Why the run is over; None if the recording does not say."""
        return RunEnd.of_plain(self.summary.get("ended"))

    @property
    def last_step(self) -> int:
        """The step at which the run was to end, as far as recorded."""
        ended = self.ended
        return self.info.total_steps if ended is None else ended.step

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The bridge's summary at the end of the run, and its wall time as `wall_s`; empty without one."""
        if (status := self._finished) is None:
            return {}
        try:
            return {**summary_fields(status.text), "wall_s": status.compute_time}
        except InputError as error:
            raise InputError(f"{self.path}: topic {STATUS}, the bridge's last message: {error}") from error

    @property
    def _finished(self) -> Status | None:
        """The bridge's last message on the end of the run; None without one."""
        ends = (s for s in reversed(self.statuses) if s.stage == BRIDGE and s.state == StageState.FINISHED)
        return next(ends, None)

    def facts(self, digest: str) -> RunFacts:
        """Returns what the run came to by its record, whose digest is `digest`."""
        wall_s, summary = (self._finished.compute_time, self._finished.text) if self._finished else (0.0, "")
        return RunFacts(self.info.run_id, int(self.tables[-1].step), digest, wall_s, summary)


class StoredMessages(Mapping[int, T]):
    """What a topic told of each step; the messages are in a temporary file and read when they are asked for."""

    def __init__(self, file: IO[bytes], places: Mapping[int, int], read: Callable[[bytes], T]) -> None:
        """Makes the view of messages in `file`, each behind its size, at `places` by step; `read` decodes one."""
        self._file, self._places, self._read = file, places, read
        self._last: tuple[int, T] | None = None

    def __getitem__(self, step: int) -> T:
        place = self._places[step]
        if self._last is None or self._last[0] != step:
            self._file.seek(place)
            size = int.from_bytes(self._file.read(SIZE_BYTES), "little")
            self._last = step, self._read(self._file.read(size))
        return self._last[1]

    def __iter__(self) -> Iterator[int]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


def read_run(path: Path) -> Run:
    """Read a run from a folder or MCAP file, as far as it reaches; raises InputError if that holds no LitSim run."""
    reader = BagReader(path)
    content = _Content(reader.topics)
    for message in reader.messages():
        topic = reader.topics[message.topic]
        try:
            if message.topic in OF_MISSION:
                content.mission.setdefault(message.topic, decoded(topic, message.data))
            elif message.topic in DECODED:
                content.take(message.topic, message.data)
            elif topic.type_name == MINIMUM_RISK_TYPE:
                content.take_minimum_risk(message.log_time_ns, decoded(topic, message.data).state)
            else:
                content.note(message.topic, message.log_time_ns)
        except UNDECODABLE as error:
            raise InputError(
                f"{reader.path}: topic {topic.name} at {message.log_time_ns * 1e-9:.1f} s: cannot be read as the "
                f"{topic.type_name} of this version: {error}"
            ) from error
    info = content.info
    if info is None or not len(content.tables):
        because = f" ({reader.problem})" if reader.problem else ""
        raise InputError(f"{reader.path}: no LitSim run: no message on {AGENTS if info else RUN_INFO}{because}")
    scenario_yaml = _scenario_yaml(reader) or info.scenario_yaml
    steps = content.tables.steps()
    return Run(
        path=reader.path,
        info=info,
        tables=steps,
        log=_log(reader, scenario_yaml, steps.step),
        **content.by_step(),
        statuses=content.statuses,
        scenario_yaml=scenario_yaml,
        net_xml=reader.attachments.get(NET_FILE, b""),
        signals=content.signals,
        mission=_mission(content.mission),
        gaps={topic: TopicGaps.find(content.steps(topic), content.last_step) for topic in info.topics},
        complete=reader.complete,
        problem=reader.problem,
        failure=read_failure(reader.path),
        seal=read_seal(reader.path),
    )


class _Content:
    """Collects the messages of one run; of two for one step, the first counts."""

    def __init__(self, topics: Mapping[str, BagTopic]) -> None:
        self.info: RunInfo | None = None
        self.tables = StepsBuilder()
        self.minimum_risk: dict[int, int] = {}
        self.mission: dict[str, Any] = {}
        self.statuses: list[Status] = []
        self._topics = topics
        self._file = SpooledTemporaryFile(SPOOLED_BYTES)  # noqa: SIM115 - closed with the views of it
        self._places: dict[str, dict[int, int]] = {}  # in the file, by topic and by step
        self._commands: dict[str, dict[int, EgoCommand]] = {}  # by topic
        self._timing: dict[str, dict[int, float]] = {}
        self._marks: dict[str, dict[int, dict[str, float]]] = {}
        self._signal_map: Any = None
        self._shown: dict[int, ByteArray] = {}
        self._steps: dict[str, array[int]] = {}
        self._times: dict[str, array[int]] = {}

    @property
    def last_step(self) -> int:
        """The step at which the run was to end: the scenario's last, unless the bridge has announced an earlier one."""
        ends = (StageState.ENDING, StageState.FINISHED)
        named = [status.step for status in self.statuses if status.stage == BRIDGE and status.state in ends]
        return min([*named, self.info.total_steps]) if self.info is not None else 0

    def note(self, topic: str, log_time_ns: int) -> None:
        """A message that is not decoded."""
        self._times.setdefault(topic, array("q")).append(log_time_ns)

    def take_minimum_risk(self, log_time_ns: int, state: int) -> None:
        """A state of the stack's minimum-risk manoeuvre."""
        self.minimum_risk[self._step_at(log_time_ns)] = int(state)

    def steps(self, topic: str) -> list[int]:
        """Returns the steps of a topic's messages, in the order of the file."""
        return [*self._steps.get(topic, ()), *map(self._step_at, self._times.get(topic, ()))]

    def _step_at(self, log_time_ns: int) -> int:
        return round(log_time_ns / (self.info.dt * 1e9 if self.info else 1.0))

    @property
    def signals(self) -> Signals | None:
        """States of the signals; unknown at steps without a message."""
        if self._signal_map is None:
            return None
        groups, links = tuple(self._signal_map.group), self._signal_map.links
        states = np.full((len(groups), max(self._shown, default=-1) + 1), int(SignalState.UNAVAILABLE), np.uint8)
        for step, state in self._shown.items():
            states[:, step] = state
        return Signals(groups, tuple(map(_signal_link, links)), np.array([link.group for link in links]), states)

    def by_step(self) -> dict[str, Any]:
        """Returns the attributes of a :class:`Run` with what was published at each step."""
        views: dict[str, Any] = {
            name: self._view(topic, self._places.get(topic, {}), read)
            for topic, reads in OF_STEP.items()
            for name, read in reads.items()
        }
        commands = self._commands.get(self._ego_topic, {})
        return views | {
            "ego_commands": commands,
            "minimum_risk": self.minimum_risk,
            "timing": self._timing,
            "marks": self._marks,
        }

    @property
    def _ego_topic(self) -> str:
        return EGO_APPLIED if self.info is not None and EGO_APPLIED in self.info.topics else EGO_CONTROL

    def _view(self, topic: str, places: Mapping[int, int], read: Callable[[Any], T]) -> StoredMessages[T]:
        return StoredMessages(self._file, places, lambda data: read(decoded(self._topics[topic], data)))

    def _store(self, places: dict[int, int], step: int, data: bytes) -> None:
        if step not in places:
            places[step] = self._file.tell()
            write_temporary(self._file, len(data).to_bytes(SIZE_BYTES, "little") + data)

    def take(self, topic: str, data: bytes) -> None:
        """A serialised message; those of another run, or of a stage that takes no part in this one, are dropped."""
        message = decoded(self._topics[topic], data)
        if topic == RUN_INFO:
            check_budget("steps of the run", message.total_steps, STEPS_MAX)
            self.info = self.info or _copy(RunInfo, message)
            return
        if self.info is not None and message.run_id != self.info.run_id:
            return
        if topic in OF_POLICY and self.info is not None and CONTROLS not in self.info.topics:
            return
        last = STEPS_MAX if self.info is None else self.info.total_steps
        if topic == SIGNAL_MAP:
            check_budget("states of signals", len(message.group) * (last + 1), CELLS_MAX)
            self._signal_map = message
            return
        step = int(message.step)
        if topic in (AGENTS, SIGNALS):
            check_budget("step", step, last)
        self._steps.setdefault(topic, array("q")).append(step)
        self._take_of_step(topic, step, message, data)

    def _take_of_step(self, topic: str, step: int, message: Any, data: bytes) -> None:
        """A message of this run about a step, `data` serialised."""
        if topic == AGENTS:
            self.tables.add(AgentTable.of_message(message))
        elif topic == self._ego_topic:
            self._commands.setdefault(topic, {}).setdefault(step, EgoCommand.of_message(message))
        elif topic in OF_STEP:
            for read in OF_STEP[topic].values():  # to find now what cannot be read when it is asked for
                read(message)
            self._store(self._places.setdefault(topic, {}), step, data)
        elif topic == TIMING:
            self._timing.setdefault(message.stage, {}).setdefault(step, message.compute_time)
            self._marks.setdefault(message.stage, {}).setdefault(step, marks_of(message.text))
        elif topic == SIGNALS:
            self._shown.setdefault(step, np.asarray(message.state, np.uint8))
        elif topic == STATUS:
            self.statuses.append(_copy(Status, message, state=StageState(message.state)))


def _copy(kind: type[T], message: Any, **ready: Any) -> T:
    """Returns a dataclass from the fields of a message that have its names; those in `ready` are given."""
    wanted = [field for field in fields(cast("Any", kind)) if field.name not in ready]
    names = [field.name for field in wanted if field.default is MISSING or hasattr(message, field.name)]
    values = {name: getattr(message, name) for name in names}
    return kind(**ready, **{name: tuple(v) if isinstance(v, list) else v for name, v in values.items()})


def _signal_link(message: Any) -> SignalLink:
    stop, leave = message.stop, message.exit
    return SignalLink(
        name=f"{message.from_lane}{ARROW}{message.to_lane}",
        from_lane=message.from_lane,
        to_lane=message.to_lane,
        stop=np.array([stop.x, stop.y]),
        heading=stop.theta,
        width=message.width,
        exit=np.array([leave.x, leave.y]),
        exit_heading=leave.theta,
    )


def _mission(messages: Mapping[str, Any]) -> Mission | None:
    """Returns the mission by its messages; None unless all are there."""
    if messages.keys() != {*OF_MISSION}:
        return None
    route, goal, lanes = (messages[topic] for topic in OF_MISSION)
    points = cloud_columns(lanes)
    ends = [stamped.pose for stamped in (*route.poses, goal)]
    places = np.array([(pose.position.x, pose.position.y) for pose in ends])
    yaw = 2.0 * np.arctan2(goal.pose.orientation.z, goal.pose.orientation.w)
    return Mission(
        places[:-1],
        np.append(places[-1], yaw),
        points["on_route"].astype(np.bool_),
        points["entered"].astype(np.float64),
    )


OF_STEP: dict[str, dict[str, Callable[[Any], Any]]] = {
    CONTROLS: {"controls": ControlTable.of_message},
    TAKEOVERS: {
        "takeovers": lambda message: [*map(Takeover.of_message, message.takeovers)],
        "detections": lambda message: Detection(int(message.iterations), bool(message.converged)),
    },
}
"""Attributes of a :class:`Run` by step that are read when they are asked for, by the topic of their messages."""


def _log(reader: BagReader, scenario_yaml: str, steps: IntArray) -> Sequence[AgentTable]:
    """Logged agents of `steps` from the attached recording; empty without one."""
    data = reader.attachments.get(RECORDING_FILE)
    if data is None:
        return []
    start = start_frame(scenario_yaml, reader.path)
    try:
        return _logged_steps(data, start, steps.tobytes())
    except InputError as error:
        raise InputError(f"{reader.path}: {error}") from error


@lru_cache(maxsize=1)
def _logged_steps(recording: bytes, start: int, steps: bytes) -> Steps:
    """Returns the logged agents of `steps`, int64; the same object for the next run of an equal log."""
    parts = Recording.parts(recording, f"attachment {RECORDING_FILE}")
    return logged_steps(parts, start, np.frombuffer(steps, np.int64))


def _scenario_yaml(reader: BagReader) -> str:
    """Returns the attached scenario; empty without one."""
    try:
        return reader.attachments.get(SCENARIO_FILE, b"").decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{reader.path}: attachment {SCENARIO_FILE}: no UTF-8 text: {error}") from error


@lru_cache(maxsize=16)
def _scenario_fields(scenario_yaml: str) -> Mapping[str, Any]:
    """Returns the fields in the text of a scenario; cached, as many runs have it in common."""
    content = load_yaml(scenario_yaml, "scenario of the run")
    return content if isinstance(content, dict) else {}


def start_frame(scenario_yaml: str, bag: Path) -> int:
    """Frame of the recording at step 0, by the text of the scenario in `bag`; raises InputError if it lacks one."""
    try:
        start = _scenario_fields(scenario_yaml).get(START_FIELD)
    except InputError as error:
        raise InputError(f"{bag}: {error}") from error
    if not isinstance(start, int):
        raise InputError(f"{bag}: scenario of the run: no whole number in field {START_FIELD!r}")
    return start
