"""What is being run, said once: which stages take part, which topics they fill, under which name."""

from __future__ import annotations

import hashlib
import platform
import subprocess
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from litsim_sim.core.scene import STEP_S
from litsim_sim.core.stages import EGO, POLICY_STAGES, RECORDER
from litsim_sim.scenario.scenario import Scenario

EXTERNAL = "external"  # whoever answers on the ego port
EGOS = ("bat", "idm", "log", "perturbed", EXTERNAL)
"""What may drive the ego; `external` is any stack that answers on the ego port."""

POLICIES = ("litsim", "yield", "replay")
"""What moves the background: `replay` is policy L alone. `litsim` takes over with the best policy that there is."""

VERSIONED = ("litsim_sim", "numpy", "libsumo", "onnxruntime", "torch", "mcap")


@dataclass(frozen=True)
class RunPlan:
    """A run of a scenario.

    Attributes:
        scenario: with the ego and the seed of this run.
        ego: one of :data:`EGOS`.
        policy: one of :data:`POLICIES`.
    """

    scenario: Scenario
    ego: str
    policy: str

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages that the bridge waits for before step 0; an external ego is met at step 0."""
        driven = () if self.policy == "replay" else POLICY_STAGES
        return (*driven, *(() if self.ego == EXTERNAL else (EGO,)), RECORDER)

    @property
    def run_id(self) -> str:
        """A name for the run that is the same for equal plans, wherever their files lie."""
        file = self.scenario.file
        names = {field: Path(getattr(file, field)).name for field in ("recording", "net")}
        default = None if file.vehicle else {"vehicle"}  # runs of before it was a field keep their names
        described = file.model_copy(update=names).model_dump_json(exclude=default)
        described = f"{described}\n{self.ego}\n{self.policy}"
        digest = hashlib.sha256(described.encode()).hexdigest()[:8]
        return f"{self.scenario.name}-{self.ego}-{self.policy}-{self.scenario.ego_id}-{self.scenario.seed}-{digest}"

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


def versions() -> dict[str, str]:
    """Versions of what a run depends on, and the commit of this tree where it is a git checkout."""
    found = {"python": platform.python_version(), "commit": _commit()}
    for package in VERSIONED:
        try:
            found[package] = metadata.version(package.replace("_", "-"))
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def _commit() -> str:
    where = Path(__file__).resolve().parent
    command = ["git", "-C", str(where), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
