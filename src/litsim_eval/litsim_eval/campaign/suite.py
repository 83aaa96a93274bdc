"""Suites: the scenarios, egos and policies of the runs of a campaign, and the criteria for them."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from glob import glob, has_magic
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from litsim_eval.campaign.criteria import Criteria
from litsim_sim.core.errors import InputError
from litsim_sim.core.latency import NAME, latency_text
from litsim_sim.core.quantities import OneOf
from litsim_sim.core.stages import BRIDGE
from litsim_sim.core.topic_names import AUTO, INTERFACES
from litsim_sim.io.input_files import require_file
from litsim_sim.io.yaml_input import parse_yaml, place_in, read_text, validate_yaml
from litsim_sim.launch.adapters import adapter_names
from litsim_sim.launch.output import OF_MANY_RUNS
from litsim_sim.scenario.policies import (
    REPLAY,
    Name,
    Parameters,
    PolicySetup,
    policy_choices,
    setup_of,
    stage_and_name,
)
from litsim_sim.scenario.run_info import EXTERNAL, ego_names
from litsim_sim.scenario.scenario import packaged, packaged_scenarios
from litsim_sim.scenario.scenario_file import SEEDS

EgoChoice = Literal["egos", "tuning", "ego", "all"]
"""Which vehicles of a scenario are the ego, one run each: those that its fields `egos`, `tuning` or `ego` list, or all
that are there from step 0 through the first simulated step."""

DEFAULT_EGOS: EgoChoice = "egos"
PACKAGE, SUITES = "litsim_eval", "suites"  # folder of the packaged ones
LATENCY = f"{BRIDGE}.{NAME}"
INTERPRETERS = ("python", "bash", "sh")
CAMPAIGN_FILE = OF_MANY_RUNS
"""In the folder of a campaign: its suite and its cases."""


PolicyName = Annotated[str, OneOf(policy_choices)]
"""A policy as it comes, or an installed setup."""


class CaseEntry(BaseModel):
    """An entry of a suite: a scenario and the vehicles that are the ego in it, one run each.

    Attributes:
        scenario: a packaged name, or a YAML file, relative to the suite's file; or a pattern of such files, such as
            `windows/*_test_*.yaml`, which stands for an entry of each.
        ego_id: the vehicle that is the ego, by its id; or several, by ids or by :data:`EgoChoice`.
        seed: seed of all randomness in these runs if the suite names no seeds; None for the scenario's.
        tags: words to filter by.
        events: what happens, as found in the recording; each with `kind`, its name, and numbers of it.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    scenario: Name
    ego_id: int | EgoChoice | Annotated[list[int], Field(min_length=1)] = DEFAULT_EGOS
    seed: Annotated[int, Field(ge=0, lt=SEEDS)] | None = None
    tags: list[Name] = []
    events: list[dict[str, Any]] = []
    _place: tuple[Path, int] | None = PrivateAttr(None)

    def within(self, suite: Path, number: int) -> CaseEntry:
        """Returns the same, as entry `number` of the file of a `suite`, which :attr:`place` names."""
        entry = self.model_copy()
        entry._place = suite, number  # noqa: SLF001 - of this class
        return entry

    @property
    def place(self) -> str:
        """The place of the entry, by file, line and field; empty if it is not from a file."""
        return place_in(self._place[0], "cases", self._place[1]) if self._place else ""

    @field_validator("events")
    @classmethod
    def _check_events(cls, events: list[dict[str, Any]]) -> list[dict[str, Any]]:
        if any(not isinstance(event.get("kind"), str) for event in events):
            raise ValueError("an event without kind, expected the name of what happens")
        return events


class EgoSetup(BaseModel):
    """Driver of the ego.

    Attributes:
        name: name in tables; default: the kind.
        kind: one of :func:`litsim_sim.scenario.run_info.ego_names`; that of an adapter is external.
        adapter: name of the adapter through which the stack drives; empty for none.
        parameters: values by `stage.name`, such as ``{ego.kind: brake}``.
        command: command that starts the stack of an external ego; none if it is started elsewhere.
        folder: where the command is started, to which its words are relative; empty for the current folder.
            :meth:`Suite.load` makes it absolute; default there: that of the suite.
        environment: variables of the command, each NAME=VALUE, or NAME for its value in the shell of the campaign,
            which :meth:`Suite.load` has put there.
        interface: interface of an external ego, one of :data:`litsim_sim.ego_port.answer.INTERFACES`.
        ready_s: time limit for the first answer of an external ego [s]; None for the launcher's default.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    name: Name
    kind: Annotated[str, OneOf(ego_names)]
    adapter: str = ""
    parameters: Parameters = {}
    command: list[Name] = []
    folder: str = ""
    environment: list[Annotated[str, Field(pattern=r"^[A-Za-z_]\w*(=.*)?$")]] = []
    interface: Annotated[str, OneOf(INTERFACES)] = AUTO
    ready_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _name_by_kind(cls, values: Any) -> Any:
        if isinstance(values, str):
            values = {"kind": values}
        if not isinstance(values, dict):
            return values
        named = {"name": values.get("kind"), **values}
        adapted = named.get("kind") in adapter_names()
        return {**named, "adapter": named["kind"], "kind": EXTERNAL} if adapted else named

    @model_serializer(mode="wrap")
    def _without_what_is_empty(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leaves empty fields out: an empty command is none that a suite may name."""
        return {name: value for name, value in dump(self).items() if value}

    @property
    def argv(self) -> list[str]:
        """The command with its folder and its variables, by the program `env`; empty without a command."""
        elsewhere = self.folder and Path(self.folder) != Path.cwd()
        if not self.command or not (elsewhere or self.environment):
            return self.command
        unset = [word for name in self.environment if "=" not in name for word in ("-u", name)]
        folder = ["-C", self.folder] if elsewhere else []
        return ["env", *folder, *unset, *(variable for variable in self.environment if "=" in variable), *self.command]

    def check_command(self) -> None:
        """Checks that the program of the command is there, and the script that an interpreter is to run.

        Raises:
            InputError: it is not.
        """
        program, *words = self.command
        where = f" in {self.folder}" if self.folder else ""
        if shutil.which(str(Path(self.folder) / program) if "/" in program else program) is None:
            raise InputError(f"ego {self.name}: {program}: no such program{where}, expected the command of a stack")
        is_script = words and not words[0].startswith("-") and Path(program).name.startswith(INTERPRETERS)
        if is_script and not (Path(self.folder) / words[0]).is_file():
            raise InputError(f"ego {self.name}: {words[0]}: no such file{where}, expected the script of a stack")

    def within(self, folder: Path) -> EgoSetup:
        """Returns the same as an entry of a suite in `folder`, with variables of the shell put in."""
        if not self.command:
            return self
        shell = [
            variable if "=" in variable or variable not in os.environ else f"{variable}={os.environ[variable]}"
            for variable in self.environment
        ]
        return self.model_copy(update={"folder": str((folder / self.folder).resolve()), "environment": shell})

    @model_validator(mode="after")
    def _check_command(self) -> EgoSetup:
        if self.kind != EXTERNAL and (self.command or self.interface != AUTO or self.ready_s is not None):
            raise ValueError(f"ego {self.name}: command, interface and ready_s belong to kind {EXTERNAL} alone")
        if (self.environment or self.folder) and not self.command:
            raise ValueError(f"ego {self.name}: folder and environment without a command")
        return self


def _starts_something(setup: Any) -> Any:
    if isinstance(setup, dict) and setup.get("command") == []:
        raise ValueError(
            "command is empty, expected the words that start the stack; without one, you start it yourself"
        )
    return setup


class Suite(BaseModel):
    """The runs of a campaign (every case with every ego, policy, combination of parameters and seed), and its criteria.

    Attributes:
        name: short name, shown by reports.
        description: purpose of the suite.
        include: other suites, packaged names or files relative to this one, whose cases come before its own;
            :meth:`load` has put them into `cases`.
        cases: scenarios, and which of their vehicles are the ego.
        egos: drivers of the ego.
        policies: of :func:`litsim_sim.scenario.policies.policy_choices`, or setups.
        seeds: seeds, with a run for each; default: the scenario's seed.
        drivers: number of draws of the background's drivers, with a run for each, for policies that draw them; with
            more than one, policy litsim does.
        end_after_contact_s: time after the first contact of its ego at which a run ends [s]; null for the scenario's.
        parameters: values to try, by `stage.name`; several values of one make several variants.
        criteria: criteria for each run, and for the campaign as a whole.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    name: Name
    description: str = ""
    include: list[Name] = []
    cases: list[CaseEntry] = []
    egos: Annotated[list[Annotated[EgoSetup, BeforeValidator(_starts_something)]], Field(min_length=1)]
    policies: Annotated[list[PolicyName | PolicySetup], Field(min_length=1)] = [REPLAY, "litsim"]
    seeds: list[Annotated[int, Field(ge=0, lt=SEEDS)]] = []
    drivers: Annotated[int, Field(ge=1)] = 1
    end_after_contact_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    parameters: dict[str, Annotated[list[Any], Field(min_length=1)]] = {}
    criteria: Annotated[Criteria, Field(default_factory=Criteria.load)]

    @field_validator("parameters", mode="before")
    @classmethod
    def _check_parameters(cls, values: Any) -> Any:
        """Makes a single value a list of one, and equal latencies equal."""
        if not isinstance(values, dict):
            return values
        listed = {stage_and_name(str(name)): v if isinstance(v, list) else [v] for name, v in values.items()}
        if LATENCY in listed:
            listed[LATENCY] = list(dict.fromkeys(latency_text(str(value)) for value in listed[LATENCY]))
        return listed

    @model_validator(mode="after")
    def _check_cases(self) -> Suite:
        if not (self.cases or self.include):
            raise ValueError("neither cases nor include, expected something to run")
        return self

    @model_validator(mode="after")
    def _check_names(self) -> Suite:
        for field in ("egos", "policies", "seeds"):
            own = EgoSetup | PolicySetup
            names = [entry.name if isinstance(entry, own) else entry for entry in getattr(self, field)]
            if twice := sorted({str(name) for name in names if names.count(name) > 1}):
                raise ValueError(f"{field}: {', '.join(twice)} more than once, expected different ones")
        return self

    @property
    def setups(self) -> list[PolicySetup]:
        """The policies, each with how its stages are set up."""
        return [setup_of(policy) for policy in self.policies]

    @classmethod
    def load(cls, name: str | Path, among: Sequence[Path] = ()) -> Suite:
        """Reads a suite; scenarios, commands, criteria and suites that it includes are found relative to its file.

        Args:
            name: a packaged name, a YAML file, or the folder of a campaign, for the suite and the cases that it has.
            among: files that include it.

        Raises:
            InputError: it cannot be read, a field does not fit, or it includes itself.
        """
        if (file := Path(name) / CAMPAIGN_FILE).is_file():
            try:
                return validate_yaml(json.loads(read_text(file))["suite"], cls, f"{file}: suite", "")
            except (ValueError, KeyError, TypeError) as error:
                raise InputError(f"{file}: not a campaign: {type(error).__name__}: {error}") from error
        path = _suite_file(name)
        if path.resolve() in among:
            raise InputError(f"{path}: field include: the suite includes itself")
        text = read_text(path)
        values = parse_yaml(text, str(path), cls)
        if isinstance(values.get("criteria"), str):
            values["criteria"] = Criteria.load(values["criteria"], path.parent)
        suite = validate_yaml(values, cls, str(path), text)
        cases = []
        for other in suite.include:
            beside = other if other in packaged_suites() else path.parent / other
            cases += cls.load(beside, (*among, path.resolve())).cases
        for number, case in enumerate(suite.cases):
            entry = case.within(path, number)
            cases += [entry.model_copy(update={"scenario": file}) for file in _files(case.scenario, path)]
        egos = [ego.within(path.parent) for ego in suite.egos]
        return suite.model_copy(update={"include": [], "cases": cases, "egos": egos})


def place_of(name: str | Path, setting: tuple[str, Any] | None) -> str:
    """Returns where a suite, by its name or file, gives a parameter, `stage.name`, this value: by file, line and field.

    The suite alone if it does not, or without a `setting`.
    """
    if setting is None or Path(name).is_dir():
        return str(name)
    suite, (parameter, value) = Suite.load(name), setting
    places: list[tuple[tuple[str | int, ...], Any]]
    places = [(("parameters", parameter), set_value) for set_value in suite.parameters.get(parameter, [])]
    for field, entries in (("policies", suite.policies), ("egos", suite.egos)):
        setups = [(number, entry) for number, entry in enumerate(entries) if not isinstance(entry, str)]
        places += [
            ((field, number, "parameters", parameter), setup.parameters.get(parameter)) for number, setup in setups
        ]
    place = next((place for place, set_value in places if set_value == value), None)
    return place_in(_suite_file(name), *place) if place else str(name)


def packaged_suite_folder() -> Path:
    """Returns the folder of the packaged suites."""
    return packaged(SUITES, PACKAGE)


def listed_suites() -> dict[str, str]:
    """Returns descriptions of the packaged suites, by name."""
    return {name: Suite.load(name).description for name in packaged_suites()}


def packaged_suites() -> tuple[str, ...]:
    """Returns names of the packaged suites, sorted."""
    return tuple(sorted(path.stem for path in packaged_suite_folder().glob("*.yaml")))


def located(scenario: str, folder: Path) -> str:
    """Returns a scenario as :meth:`litsim_sim.scenario.scenario.Scenario.load` finds it from anywhere.

    A packaged name stays as it is; the path of a file, relative to `folder`, or else to that of the packaged suites,
    becomes absolute.
    """
    if scenario in packaged_scenarios():
        return scenario
    of_suite = packaged_suite_folder() / scenario
    is_packaged = of_suite.is_file() and not (folder / scenario).exists()
    return str((of_suite if is_packaged else folder / scenario).resolve())


def _files(scenario: str, suite: Path) -> list[str]:
    """Returns the scenarios of an entry of a `suite`, sorted: one, or as many as there are files of the pattern.

    Raises:
        InputError: it is a pattern, and there is none.
    """
    place = located(scenario, suite.parent)
    if not has_magic(scenario) or Path(place).exists():
        return [place]
    names = sorted(glob(scenario, root_dir=suite.parent, recursive=True))  # noqa: PTH207 - takes absolute ones, too
    if not names:
        raise InputError(f"{suite}: field cases: scenario {scenario}: no file has such a name")
    return [located(name, suite.parent) for name in names]


def _suite_file(name: str | Path) -> Path:
    """Returns the file of a suite, packaged or not; raises InputError if there is no such suite."""
    if name in packaged_suites():
        return packaged(f"{SUITES}/{name}.yaml", PACKAGE)
    hint = f", expected a YAML file, the folder of a campaign, or one of {', '.join(packaged_suites())}"
    require_file(Path(name), "suite", hint)
    return Path(name)
