"""What is being run, said once: which stages take part, which topics they fill, under which name."""

from __future__ import annotations

import hashlib
import json
import platform
import secrets
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from litsim_sim.core.parameters import Parameters, by_stage
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.stages import EGO, POLICY_STAGES, RECORDER
from litsim_sim.scenario.scenario import Scenario

EXTERNAL = "external"  # whoever answers on the ego port
OWN_EGOS = ("bat", "idm", "log", "perturbed")
"""Egos that have a stage here, over DDS or in process."""

EGOS = (*OWN_EGOS, EXTERNAL)
"""What may drive the ego; `external` is any stack that answers on the ego port."""

REPLAY = "replay"  # the recording alone: no stage of the policy takes part
BASELINES = ("idm", "gail", "rail", "simnet")
"""Policies that drive whoever comes near the ego, for good, and ask for no forecasts."""

POLICIES = ("litsim", "yield", *BASELINES, REPLAY)
"""What moves the background: `replay` is policy L alone. `litsim` takes over with the best policy that there is."""

VERSIONED = ("litsim_sim", "numpy", "libsumo", "onnxruntime", "torch", "mcap")


@dataclass(frozen=True)
class RunPlan:
    """A run of a scenario.

    Attributes:
        scenario: with the ego and the seed of this run.
        ego: one of :data:`EGOS`.
        policy: one of :data:`POLICIES`.
        parameters: those of the stages that are set to something, by stage and name; the others are at their defaults.
        execution: which of all executions of this run it is, a word of :func:`new_execution`; empty in process, where
            no message of another execution can come in.
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
        end_after_contact_s: float | None = None,
        vehicle: Mapping[str, float] | None = None,
        settings: Iterable[tuple[str, str, Any]] = (),
    ) -> RunPlan:
        """The run that somebody asks for; None leaves a thing to the scenario, or to the stage's default.

        Args:
            scenario: name of a packaged scenario, or a YAML file.
            ego, policy: see the attributes.
            predictor: model that forecasts; without meaning in a replay, where nothing is forecast.
            ego_id: vehicle of the recording that is the ego.
            seed: of everything random in the run.
            end_after_contact_s: time after the ego's first contact at which the run is over [s].
            vehicle: fields of the ego's vehicle model.
            settings: stage, name and value of parameters.

        Raises:
            InputError: the scenario cannot be used.
        """
        overrides: dict[str, Any] = {
            "ego": ego_id,
            "seed": seed,
            "end_after_contact_s": end_after_contact_s,
            "vehicle": dict(vehicle or {}) or None,
        }
        loaded = Scenario.load(scenario, **{name: value for name, value in overrides.items() if value is not None})
        model = [] if predictor is None or policy == REPLAY else [("predictor", "model", predictor)]
        return cls(loaded, ego, policy, by_stage([*model, *settings]))

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages that the bridge waits for before step 0; an external ego is met at step 0."""
        driven = () if self.policy == REPLAY else POLICY_STAGES
        return (*driven, *(() if self.ego == EXTERNAL else (EGO,)), RECORDER)

    @property
    def identity(self) -> str:
        """The same for equal runs, wherever their files lie; of runs that may differ in anything, not the same."""
        file = self.scenario.file
        names = {each: Path(getattr(file, each)).name for each in ("recording", "net")}
        without = {"coverage_min"}  # decides whether there is a run, not what happens in it
        # runs of before these were fields keep their names
        without |= {name for name in ("vehicle", "end_after_contact_s") if getattr(file, name) in ({}, None)}
        described = file.model_copy(update=names).model_dump_json(exclude=without)
        described = f"{described}\n{self.ego}\n{self.policy}"
        if self.stage_parameters:
            described += f"\n{json.dumps(plain_values(self.stage_parameters), sort_keys=True)}"
        digest = hashlib.sha256(described.encode()).hexdigest()[:8]
        return f"{self.scenario.name}-{self.ego}-{self.policy}-{self.scenario.ego_id}-{self.scenario.seed}-{digest}"

    @property
    def stage_parameters(self) -> Parameters:
        """Those of :attr:`parameters` that change what happens: of all but the bridge and the recorder."""
        return {stage: self.parameters[stage] for stage in (*POLICY_STAGES, EGO) if self.parameters.get(stage)}

    @property
    def run_id(self) -> str:
        """The name under which messages travel: the identity, and the execution where it has a word of its own."""
        return f"{self.identity}@{self.execution}" if self.execution else self.identity

    def facts(self) -> dict[str, Any]:
        """What holds of the run however it is run: fields of ``RunInfo``, the message and that of a record."""
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


def new_execution() -> str:
    """A word that no execution of a run had before: what an earlier one has left behind is not taken for this one's."""
    return secrets.token_hex(4)


def plain_values(value: Any) -> Any:
    """`value` for JSON, numbers of equal value alike: 2 sets a parameter to the same as 2.0."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(each) for each in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def versions() -> dict[str, str]:
    """Versions of what a run depends on, and the commit of this tree where it is a git checkout."""
    found = {"python": platform.python_version(), "commit": commit()}
    for package in VERSIONED:
        try:
            found[package] = metadata.version(package.replace("_", "-"))
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


@cache
def commit() -> str:
    """The commit of this tree where it is a git checkout, as it is when that is asked for first: git takes 15 ms."""
    where = Path(__file__).resolve().parent
    command = ["git", "-C", str(where), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
