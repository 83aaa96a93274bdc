"""A recorded run played into a stack, open loop: the stack answers, and all moves on as recorded."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from litsim_eval.runs.recorded_run import Record, open_record
from litsim_sim.cli.launch import launch
from litsim_sim.cli.launch import parser as launch_parser
from litsim_sim.core.errors import EXIT_FAILED, InputError
from litsim_sim.core.scene import STEP_S, EgoCommand, EgoMode
from litsim_sim.record.run import NET_FILE, RECORDING_FILE, SCENARIO_FILE, Run, read_run
from litsim_sim.scenario.recording import COLUMNS, Recording
from litsim_sim.scenario.scenario import Scenario

ROUNDING = 1e-9  # [m/s2, rad/s] up to which commands are equal: a record as a log is rounded otherwise
HANDLED = {"acceleration": ("acceleration", "m/s²"), "yaw_rate": ("yaw rate", "rad/s")}
"""Names and units of what is compared of the commands."""


@dataclass(frozen=True)
class Difference:
    """By how much a part of the commands differs.

    Attributes:
        mean, largest: absolute differences.
        step: where it is largest.
    """

    mean: float
    largest: float
    step: int


def play_into(bag: Path, command: Sequence[str], out: Path, *, overwrite: bool) -> dict[str, Any]:
    """Lets a stack answer the steps of a record, and compares its commands with the recorded ones.

    The record of the answers is in `out`. Returns the number of `compared` steps, a :class:`Difference` for each of
    HANDLED, None without a step to compare, and the number of `unusable` answers: those before were held.

    Raises:
        InputError: the record cannot be used, or the stack cannot be started.
        OpenLoopFailed: the run with the stack has failed; the launcher has said why.
    """
    with open_record(bag) as record, _as_log(record) as scenario:
        options = ["--scenario", str(scenario), "--ego", "external", "--policy", "replay", "--out", str(out)]
        options += ["--no-analyze", "--quiet", "--on-invalid", "hold", *(["--overwrite"] if overwrite else [])]
        arguments = launch_parser().parse_args([*options, "--set", "bridge.open_loop=true", "--", *command])
        if launch(arguments) == EXIT_FAILED:
            raise OpenLoopFailed
    run, played = record.run, read_run(out)
    unusable = int((played.summary.get("ego_port") or {}).get("invalid", 0))
    return compared(run.ego_commands, played.ego_commands, run.info.history_steps) | {"unusable": unusable}


class OpenLoopFailed(Exception):
    """The run with the stack has failed, and has said why."""


@contextmanager
def _as_log(record: Record) -> Iterator[Path]:
    """Yields the file of a scenario whose log is the run, and whose ego is never free but at its last step."""
    run, source = record.run, record.scenario
    there = run.steps.step[run.steps.stacked.number[run.steps.track(run.info.ego_id)]]
    if len(there) < 3:
        raise InputError(f"{run.path}: the ego is recorded at {len(there)} steps, expected three at least")
    last = int(there[-1])
    with tempfile.TemporaryDirectory(prefix="litsim-open-loop-") as name:
        folder = Path(name)
        net = folder / (source.recording.header.net or NET_FILE)
        net.write_bytes(source.net_path.read_bytes())
        _recording(source, run).write(folder / RECORDING_FILE)
        frames = {"start_frame": source.start_frame, "history_s": (last - 1) * STEP_S, "simulation_s": STEP_S}
        given: dict[str, Any] = {
            "recording": RECORDING_FILE,
            "net": net.name,
            "crop": None,
            "changes": [],
            "egos": [],
            "tuning": [],
        }
        values = source.file.model_dump(mode="json") | given | frames | {"coverage_min": 0.0}
        (folder / SCENARIO_FILE).write_text(yaml.safe_dump(values))
        yield folder / SCENARIO_FILE


def _recording(scenario: Scenario, run: Run) -> Recording:
    """Returns the motion of all agents of a run."""
    table = run.steps.stacked
    columns: dict[str, Any] = {name: getattr(table, name) for name in COLUMNS if hasattr(table, name)}
    frames = scenario.start_frame + run.steps.step[table.number]
    rows = pd.DataFrame(columns | {"vehicle_id": table.id, "frame": frames, "lane": -1})
    return Recording.from_table(scenario.recording.header, rows[list(COLUMNS)], str(run.path))


def compared(recorded: Mapping[int, EgoCommand], answered: Mapping[int, EgoCommand], begin: int) -> dict[str, Any]:
    """Returns how many commands from step `begin` on are in both, and their :class:`Difference` for each of HANDLED."""
    steps = [step for step in sorted(recorded) if step >= begin and step in answered]
    steps = [step for step in steps if recorded[step].mode == answered[step].mode == EgoMode.CONTROL]
    result: dict[str, Any] = {"compared": len(steps)}
    for name in HANDLED:
        apart = np.array([abs(getattr(recorded[step], name) - getattr(answered[step], name)) for step in steps])
        worst = int(np.argmax(apart)) if steps else 0
        result[name] = Difference(float(apart.mean()), float(apart[worst]), steps[worst]) if steps else None
    return result


def sentence(result: Mapping[str, Any]) -> str:
    """Returns the differences in a line."""
    if not result["compared"]:
        return "no answer can be compared: the ego of the record followed its log"
    parts = []
    for field, (name, unit) in HANDLED.items():
        apart: Difference = result[field]
        where = f" (at {apart.step * STEP_S:.1f} s)" if apart.largest else ""
        parts.append(f"{name} by {apart.mean:.3g} {unit} in the mean, {apart.largest:.3g} at most{where}")
    equal = all(result[field].largest < ROUNDING for field in HANDLED)
    differ = f"they differ from the recorded commands: {'; '.join(parts)}"
    held = f"; {result['unusable']} could not be used, and those before were held" if result.get("unusable") else ""
    return f"{result['compared']} answers: {'equal to the recorded commands' if equal else differ}{held}"
