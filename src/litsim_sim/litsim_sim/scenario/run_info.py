"""Description of a run: scenario, ego, policy, stages, parameters, and its identity."""

from __future__ import annotations

import hashlib
import json
import platform
import secrets
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

from litsim_sim.core import plugins
from litsim_sim.core.latency import NAME as LATENCY
from litsim_sim.core.latency import NONE, latency_in
from litsim_sim.core.parameters import Parameters, by_stage
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.stages import BRIDGE, EGO, POLICY_STAGES, RECORDER
from litsim_sim.scenario.policies import REPLAY, setup_of
from litsim_sim.scenario.scenario import Scenario

EXTERNAL = "external"
"""The ego that is any stack that answers on the ego port."""
IN_PROCESS = "in-process"
"""The mode of a run without ROS, of which there is no record."""
VERSIONED = ("litsim_sim", "numpy", "libsumo", "onnxruntime", "torch", "mcap")


@dataclass(frozen=True)
class RunPlan:
    """A run of a scenario.

    Attributes:
        scenario: scenario with the ego and the seed of this run.
        ego: one of :func:`ego_names`.
        policy: one of :func:`litsim_sim.scenario.policies.policy_names`.
        parameters: parameters of the stages that are set explicitly, by stage and name.
        execution: unique name of this execution, see :func:`new_execution`; empty in process, where messages of other
            executions cannot arrive.
    """

    scenario: Scenario
    ego: str
    policy: str
    parameters: Parameters = field(default_factory=dict)
    execution: str = ""

    @classmethod
    def load(
        cls,
        scenario: str | Path,
        ego: str,
        policy: str,
        *,
        predictor: str | None = None,
        ego_id: int | None = None,
        seed: int | None = None,
        draw: int | None = None,
        end_after_contact_s: float | None = None,
        vehicle: Mapping[str, float] | None = None,
        settings: Iterable[tuple[str, str, Any]] = (),
    ) -> RunPlan:
        """Returns the run with the given options; None stands for the scenario's value, or the stage's default.

        `policy` may be a setup (:mod:`litsim_sim.scenario.policies`), over whose parameters the given ones go.
        `settings` are stage, name and value of parameters; the `predictor` is ignored in a replay. Raises an
        InputError if the scenario, a name or a YAML file, cannot be used.
        """
        given: dict[str, Any] = {"ego": ego_id, "seed": seed, "draw": draw, "end_after_contact_s": end_after_contact_s}
        loaded = Scenario.load(scenario, **given, vehicle=dict(vehicle or {}) or None)
        setup = setup_of(policy)
        model = [] if predictor is None or setup.kind == REPLAY else [("predictor", "model", predictor)]
        return cls(loaded, ego, setup.kind, setup.stage_parameters(by_stage([*model, *settings])))

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages that the bridge waits for before step 0; an external ego is waited for at step 0."""
        driven = () if self.policy == REPLAY else POLICY_STAGES
        return (*driven, *(() if self.ego == EXTERNAL else (EGO,)), RECORDER)

    @cached_property
    def identity(self) -> str:
        """Identity of the run: equal for equal runs, independent of the locations of files; else different."""
        file = self.scenario.file
        names = {name: Path(getattr(file, name)).name for name in ("recording", "net")}
        without = {"coverage_min"}  # affects whether a run is possible, not its result
        # left out at their defaults, so that runs of older versions keep their identities
        new = ("vehicle", "end_after_contact_s", "changes", "draw", "goal")
        without |= {name for name in new if getattr(file, name) in ({}, [], None, 0)}
        described = file.model_copy(update=names).model_dump_json(exclude=without)
        described = f"{described}\n{self.ego}\n{self.policy}"
        if self.stage_parameters:
            described += f"\n{json.dumps(plain_values(self.stage_parameters), sort_keys=True)}"
        digest = hashlib.sha256(described.encode()).hexdigest()[:8]
        return f"{self.scenario.name}-{self.ego}-{self.policy}-{self.scenario.ego_id}-{self.scenario.seed}-{digest}"

    @property
    def stage_parameters(self) -> Parameters:
        """The part of :attr:`parameters` that affects the result: of bridge and recorder only the latency."""
        of_stages = {stage: self.parameters[stage] for stage in (*POLICY_STAGES, EGO) if self.parameters.get(stage)}
        return of_stages if self.latency == NONE else of_stages | {BRIDGE: {LATENCY: self.latency}}

    @property
    def latency(self) -> str:
        """The time by which answers of the ego's driver count later; see :mod:`litsim_sim.core.latency`."""
        return latency_in(self.parameters)

    @property
    def applied(self) -> bool:
        """Whether the bridge tells what became of the ego's answers: they are converted, or count later."""
        return self.ego == EXTERNAL or self.latency != NONE

    @cached_property
    def run_id(self) -> str:
        """Id of the run in messages: the identity, with the execution if it has a name."""
        return f"{self.identity}@{self.execution}" if self.execution else self.identity

    def facts(self) -> dict[str, Any]:
        """Fields of ``RunInfo``, in the message and in the recording, that do not depend on how the run is executed."""
        return {
            "run_id": self.run_id,
            "scenario": self.scenario.name,
            "scenario_yaml": self.scenario.to_yaml(),
            "ego": self.ego,
            "policy": self.policy,
            "ego_id": self.scenario.ego_id,
            "seed": self.scenario.seed,
            "total_steps": self.scenario.total_steps,
            "history_steps": self.scenario.history_steps,
            "dt": STEP_S,
            "stages": self.stages,
        }


def driver_names() -> tuple[str, ...]:
    """Returns the names of the installed drivers of the ego, each a stage over DDS or in process."""
    return plugins.names(plugins.EGOS)


def ego_names() -> tuple[str, ...]:
    """Returns the names of what can drive the ego: :func:`driver_names`, and a stack of the user."""
    return (*driver_names(), EXTERNAL)


def new_execution() -> str:
    """Returns a unique name of an execution, so that messages left over from earlier ones are not taken for its own."""
    return secrets.token_hex(4)


def plain_values(value: Any) -> Any:
    """Returns `value` for JSON, with equal numbers in equal form: 2 and 2.0 set a parameter to the same value."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(content) for key, content in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def versions() -> dict[str, str]:
    """Returns the versions of the dependencies of a run, and the commit of this source tree if it is a git checkout."""
    by_package = {package: _version(package) for package in VERSIONED}
    return {"python": platform.python_version(), "commit": commit(), **by_package}


@cache
def _version(package: str) -> str:
    try:
        return metadata.version(package.replace("_", "-"))
    except metadata.PackageNotFoundError:
        return "not installed"


@cache
def commit() -> str:
    """Returns the commit of this source tree if it is a git checkout; cached at the first call, as git takes 15 ms."""
    where = Path(__file__).resolve().parent
    command = ["git", "-C", str(where), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
