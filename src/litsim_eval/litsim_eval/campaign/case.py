"""Cases: single runs of a suite, and their identities."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any, Literal

from litsim_eval.campaign.suite import CaseEntry, EgoChoice, EgoSetup, Suite
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import Parameters, by_place
from litsim_sim.core.stages import BRIDGE, POLICY_STAGES
from litsim_sim.scenario.policies import REPLAY
from litsim_sim.scenario.run_info import EXTERNAL, plain_values, versions
from litsim_sim.scenario.scenario import Scenario

ID_LENGTH = 16
SCENARIOS_KEPT = 4  # most scenarios in memory while cases are made
MODEL = "model"  # a parameter that labels of variants name by its value alone
DRAWING, DRIVERS, DRAWN = "litsim", "policy.drivers", "drawn"  # the policy that draws drivers, and how it is told to
PATIENCE = f"{BRIDGE}.external_timeout_s"  # the parameter that `ready_s` of an ego sets
NOT_OF_THE_RESULT = ("commit",)
"""Versions that reports show but that do not affect identities: the digest of the sources does."""
OF_NO_RUN = {"name", "description", "ego", "egos", "tuning", "seed", "draw", "end_after_contact_s"}
"""Fields of a scenario that do not affect its runs, or that a case states itself."""

SINCE = ("changes", "goal")
"""Fields of a scenario that older versions did not have: left out where unset, so that identities stay the same."""

ExecutionMode = Literal["graph", "process"]
GRAPH: ExecutionMode = "graph"
PROCESS: ExecutionMode = "process"
Settings = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Case:
    """One run of a campaign.

    Attributes:
        id: digest of everything that decides its result; equal for equal runs.
        key: the same without what may differ between two versions of one system: versions of packages, and how the ego
            of that name is made. Cases of two campaigns are matched by it.
        name: readable name, unique in a campaign.
        scenario: a packaged name, or the absolute path of a file.
        ego_id: id of the vehicle that is the ego.
        ego: driver of the ego.
        policy: what moves the background.
        label: distinguishes the variant from others of the same ego and policy; may be empty.
        seed: seed of all randomness; None for the scenario's.
        draw: number of the draw of the background's drivers; None for the scenario's.
        end_after_contact_s: time after the ego's first contact at which the run ends [s]; None for the scenario's.
        parameters: `stage.name` and value of each parameter set by the variant; those of the ego are in `ego`.
        execution_mode: whether it is run over DDS or in process.
        files: digests of the files that its command and its parameters name.
        tags, events: as the suite gives them.
    """

    id: str
    key: str
    name: str
    scenario: str
    ego_id: int
    ego: EgoSetup
    policy: str
    label: str
    seed: int | None
    draw: int | None
    end_after_contact_s: float | None
    parameters: Settings
    execution_mode: ExecutionMode
    files: Mapping[str, str] = field(default_factory=dict)
    tags: tuple[str, ...] = ()
    events: tuple[Mapping[str, Any], ...] = ()

    def __hash__(self) -> int:
        """By the id alone: setups and events have no hash."""
        return hash(self.id)

    @property
    def vehicle(self) -> tuple[str, int]:
        """The vehicle that is the ego: its scenario and id."""
        return self.scenario, self.ego_id

    @property
    def of_all_draws(self) -> str:
        """The name without the number of the draw."""
        return self.name.removesuffix(_draw_text(self.draw))

    @property
    def variant(self) -> str:
        """Name of what campaigns compare, by which runs are counted together: ego, policy and label."""
        return ", ".join(part for part in (self.ego.name, self.policy, self.label) if part)

    @property
    def stage_parameters(self) -> Parameters:
        """All parameters of the run by stage and name, with those of the ego and how long the bridge waits for it."""
        values = {**self.ego.parameters, **dict(self.parameters)}
        if self.ego.ready_s is not None:
            values[PATIENCE] = self.ego.ready_s
        return by_place(values.items())

    def to_json(self) -> dict[str, Any]:
        """Returns the case as values for JSON; the inverse of :meth:`from_json`."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        own |= {"ego": self.ego.name, "ego_setup": self.ego.model_dump(mode="json"), "variant": self.variant}
        return own | {"parameters": dict(self.parameters), "tags": [*self.tags], "events": [*self.events]}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Case:
        """Returns what :meth:`to_json` was made of; raises KeyError or ValueError for other values."""
        own = {"draw": None, "end_after_contact_s": None, "files": {}, **values}  # which were not always there
        own["execution_mode"] = values.get("execution_mode") or values["shell"]  # its name in format 1
        own |= {"ego": EgoSetup(**values["ego_setup"]), "parameters": tuple(values["parameters"].items())}
        own |= {"tags": tuple(values["tags"]), "events": tuple(values["events"])}
        return cls(**{name: own[name] for name in cls.__dataclass_fields__})


def what_differs(own: Case, other: Case, versions: Mapping[str, str], other_versions: Mapping[str, str]) -> str:
    """Returns in one line why two cases of one name have different ids; `versions` are those of the dependencies."""
    texts = [
        f"{name} has changed" for name in sorted(own.files.keys() & other.files) if own.files[name] != other.files[name]
    ]
    before, now = (case.ego.model_dump(mode="json", exclude={"folder"}) for case in (own, other))
    texts += [
        f"{name} of ego {own.ego.name} was {_said(before.get(name))}, is {_said(now.get(name))}"
        for name in sorted(before.keys() | now)
        if before.get(name) != now.get(name)
    ]
    if own.parameters != other.parameters:
        texts.append("the parameters have changed")
    elif own.key != other.key:
        texts.append("the scenario, its recording or its net has changed")
    if own.execution_mode != other.execution_mode:
        texts.append(f"it ran as {own.execution_mode}, now as {other.execution_mode}")
    texts += [
        f"{'LitSim itself has' if name == 'sources' else f'{name} {versions.get(name)}, now {version}: has'} changed"
        for name, version in other_versions.items()
        if name not in NOT_OF_THE_RESULT and versions.get(name) != version
    ]
    return "; ".join(texts) or "a file that the command or a parameter names has come or gone"


def _said(value: Any) -> str:
    """Returns a field of a setup as a user writes it."""
    return " ".join(map(str, value)) if isinstance(value, list) else json.dumps(value)


def cases_of(suite: Suite, *, graph: bool = False, with_versions: Mapping[str, str] | None = None) -> list[Case]:
    """Returns every case of a suite, sorted by variant, seed, draw and entry.

    Entries that give the same run are one case, with the tags and events of all.

    Args:
        suite: with scenarios that :meth:`Scenario.load` finds from here.
        graph: whether egos of LitSim's own are run over DDS, too; external ones always are.
        with_versions: versions of the dependencies of a run; default: those of this installation.

    Raises:
        InputError: a scenario cannot be used, an ego is not in it, or two scenarios have the same name; it names file
            and line of the entry, where it has them. Or two variants are of the same runs.
    """
    _check_scenario_names(suite)
    versions_of_all = code_versions() if with_versions is None else with_versions
    deciding = {name: version for name, version in versions_of_all.items() if name not in NOT_OF_THE_RESULT}
    load = lru_cache(maxsize=SCENARIOS_KEPT)(Scenario.load)  # entries of one scenario follow each other
    roads = [road for entry in suite.cases for road in _roads(entry, load)]
    seeds: list[int | None] = [*suite.seeds] or [None]
    cases: dict[str, Case] = {}
    runs = [(variant, *run) for variant in variants(suite) for run in product(seeds, variant.draws(suite), roads)]
    for variant, seed, draw, road in runs:
        case = _case(variant, seed, draw, suite.end_after_contact_s, road, graph=graph, deciding=deciding)
        same = cases.get(case.id)
        if same is not None and same.variant != case.variant:
            raise InputError(
                f"suite {suite.name}: variants {same.variant!r} and {case.variant!r} ask for the same runs, "
                f"expected different policies or parameters; those of the suite replace those of a policy or an ego"
            )
        if same is not None:
            events = [*same.events, *(event for event in case.events if event not in same.events)]
            tags = dict.fromkeys((*same.tags, *case.tags))
            case = replace(same, tags=tuple(tags), events=tuple(events))
        cases[case.id] = case
    return list(cases.values())


def chosen_egos(choice: int | EgoChoice | Sequence[int], scenario: Scenario) -> tuple[int, ...]:
    """Returns ids of the vehicles of `scenario` that are the ego, one run each.

    Raises:
        InputError: the scenario lists none, or one that was chosen is not present at its start.
    """
    if isinstance(choice, int):
        choice = [choice]
    if choice == "ego":
        return (scenario.ego_id,)
    if choice == "all":
        return scenario.possible_egos
    if isinstance(choice, str):
        listed = scenario.egos if choice == "egos" else scenario.tuning_egos
        if not listed:
            raise InputError(f"{scenario.name}: field {choice} of the scenario lists no egos")
        return listed
    if absent := sorted(set(choice) - set(scenario.possible_egos)):
        named = ", ".join(map(str, absent))
        raise InputError(f"ego_id: {named} not there at the start of {scenario.name}, expected vehicles that are")
    return tuple(choice)


def code_versions() -> dict[str, str]:
    """Returns versions of the dependencies of a run, and as `sources` a digest of the packages with stages."""
    return {**versions(), "sources": _sources()}


@dataclass(frozen=True)
class Variant:
    """The common properties of all runs of a variant."""

    ego: EgoSetup
    policy: str
    parameters: Settings
    label: str

    def draws(self, suite: Suite) -> list[int | None]:
        """Returns the numbers of the draws of its drivers: those of `suite` if it draws any, else the scenario's."""
        if suite.drivers == 1 or DRAWN not in (value for name, value in self.parameters if name.endswith("drivers")):
            return [None]
        return list(range(suite.drivers))


@dataclass(frozen=True)
class _Road:
    """An entry of the suite for one of its egos, with seed, draw, end and other content of its scenario."""

    entry: CaseEntry
    ego_id: int
    seed: int
    draw: int
    end: float | None
    content: Mapping[str, Any]


def variants(suite: Suite) -> Iterator[Variant]:
    """Yields every variant: each ego with each policy and combination of parameters.

    Parameters of the policy's stages make no variants of a replay, which has none of these stages. Labels tell the
    parameters that have several values, and those of the ego or the policy that the suite replaces.
    """
    for ego, setup in product(suite.egos, suite.setups):
        drawing = {DRIVERS: DRAWN} if suite.drivers > 1 and setup.kind == DRAWING else {}
        own = {**ego.parameters, **drawing, **setup.parameters}
        varied_by = {
            name: values
            for name, values in suite.parameters.items()
            if setup.kind != REPLAY or name.split(".")[0] not in POLICY_STAGES
        }
        for values in product(*varied_by.values()):
            varied = dict(zip(varied_by, values, strict=True))
            labels = [
                str(value) if short == MODEL else f"{short}={value}"
                for name, value in varied.items()
                for short in [name.split(".", 1)[1]]
                if len(varied_by[name]) > 1 or short == MODEL or own.get(name, value) != value
            ]
            label = ", ".join(part for part in (setup.label, *labels) if part)
            yield Variant(ego, setup.kind, tuple({**drawing, **setup.parameters, **varied}.items()), label)


def _roads(entry: CaseEntry, load: Callable[[str], Scenario]) -> list[_Road]:
    """Returns an entry of the suite for each vehicle that is the ego.

    Raises:
        InputError: the scenario cannot be used, or an ego is not in it.
    """
    try:
        scenario = load(entry.scenario)
        egos = chosen_egos(entry.ego_id, scenario)
    except InputError as error:
        raise InputError(": ".join(filter(None, (entry.place, str(error))))) from error
    file = scenario.file
    unset = {name for name in SINCE if not getattr(file, name)}
    content = file.model_dump(mode="json", exclude=OF_NO_RUN | unset)
    files = {field: Path(getattr(file, field)) for field in ("recording", "net")}
    content |= {field: [path.name, file_digest(path)] for field, path in files.items()}
    return [_Road(entry, ego_id, scenario.seed, file.draw, file.end_after_contact_s, content) for ego_id in egos]


def _case(
    variant: Variant,
    seed: int | None,
    draw: int | None,
    end: float | None,
    road: _Road,
    *,
    graph: bool,
    deciding: Mapping[str, str],
) -> Case:
    short, ego = Path(road.entry.scenario).stem, variant.ego
    seed = road.entry.seed if seed is None else seed
    question = {
        "scenario": [short, road.content],
        "ego_id": str(road.ego_id),
        "ego": ego.name,
        "policy": variant.policy,
        "parameters": dict(variant.parameters),
        "seed": road.seed if seed is None else seed,
    }
    ends = road.end if end is None else end
    if ends is not None:  # questions of before runs could end so stay the same
        question["end_after_contact_s"] = ends
    if drawn := road.draw if draw is None else draw:  # likewise
        question["draw"] = drawn
    mode = GRAPH if graph or ego.kind == EXTERNAL else PROCESS
    settings = [*ego.parameters.values(), *dict(variant.parameters).values()]
    files = _files(settings) | _files(ego.command, ego.folder)
    setup = {"ego": ego.model_dump(mode="json", exclude={"folder"}), "files": files}
    name = "/".join((short, str(road.ego_id), ego.name, variant.policy, *([] if seed is None else [str(seed)])))
    return Case(
        id=digest({"question": question, "setup": setup, "execution_mode": mode, "versions": deciding}),
        key=digest(question),
        name=", ".join(part for part in (name, variant.label) if part) + _draw_text(draw),
        scenario=road.entry.scenario,
        ego_id=road.ego_id,
        ego=ego,
        policy=variant.policy,
        label=variant.label,
        seed=seed,
        draw=draw,
        end_after_contact_s=end,
        parameters=variant.parameters,
        execution_mode=mode,
        files=files,
        tags=tuple(road.entry.tags),
        events=tuple(road.entry.events),
    )


def _draw_text(draw: int | None) -> str:
    """Returns the end of the name of a case with this draw."""
    return "" if draw is None else f", drivers {draw}"


def _check_scenario_names(suite: Suite) -> None:
    """Checks that the scenarios' files have unique names, by which runs are distinguished.

    Raises:
        InputError: two files have the same name.
    """
    by_name: dict[str, set[str]] = {}
    for entry in suite.cases:
        by_name.setdefault(Path(entry.scenario).stem, set()).add(entry.scenario)
    for name, files in by_name.items():
        if len(files) > 1:
            raise InputError(f"suite {suite.name}: scenarios {', '.join(sorted(files))} are all called {name}")


@lru_cache(maxsize=1)
def _sources() -> str:
    groups = (plugins.STAGES, plugins.POLICIES, plugins.EGOS, plugins.PREDICTORS, plugins.METRICS)
    packages = {entry.module.split(".")[0] for group in groups for entry in plugins.installed(group).values()}
    packages.add(__name__.split(".")[0])
    total = hashlib.sha256()
    for package in sorted(packages):
        spec = find_spec(package)
        for folder in sorted((spec and spec.submodule_search_locations) or ()):
            for path in sorted(Path(folder).rglob("*")):
                if path.is_file() and "__pycache__" not in path.parts:
                    total.update(f"{package}/{path.relative_to(folder)}\0{file_digest(path)}\n".encode())
    return total.hexdigest()[:ID_LENGTH]


def file_digest(path: Path) -> str:
    """Returns the SHA-256 of the file at `path`, in hexadecimal digits."""
    status = path.stat()
    return _file_digest(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=4096)
def _file_digest(path: Path, size: int, changed_ns: int) -> str:  # noqa: ARG001 - another size or time: another file
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _files(values: Sequence[Any], folder: str = "") -> dict[str, str]:
    """Returns digests of those of `values` that are paths of files in `folder`, such as scripts and weights.

    With a Python script come the modules beside it, which it may import.
    """
    paths = [Path(value) for value in values if isinstance(value, str) and value]
    paths = [path for path in paths if Path(folder, path).is_file()]
    for script in [path for path in paths if path.suffix == ".py"]:
        paths += [script.with_name(path.name) for path in sorted(Path(folder, script).parent.glob("*.py"))]
    return {str(path): file_digest(Path(folder, path).resolve()) for path in paths}


def digest(values: Mapping[str, Any]) -> str:
    """Returns the digest of values that JSON can hold, by which cases are told apart."""
    text = json.dumps(plain_values(values), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:ID_LENGTH]
