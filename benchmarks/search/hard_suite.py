"""The hard suite: cases of generated and recorded traffic in which somebody is in the ego's way.

    ./litsim exec python benchmarks/search/hard_suite.py FOLDER             # makes FOLDER/hard.yaml and its scenarios
    ./litsim exec python benchmarks/search/hard_suite.py FOLDER --choose    # also chooses the cases anew

The cases are in `examples/suites/hard_cases.yaml`: a piece of traffic, an ego, and what is changed. They are chosen
among random ones of each kind by two runs with the traffic on its log: the careful driver must pass, and go half as far
as the recorded vehicle, or a tenth where it has to stop; and in at most CALM of a kind nobody touches the ego `idm`. No
planted weakness takes part in that. Recorded traffic is what LITSIM_DATA names; without it, its cases are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from compare import CAREFUL, planted
from hard_candidates import WALKERS, Candidate, candidates, encounters, recorded

from litsim_data.cli import main as data
from litsim_data.mining.mine import possible_egos
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.campaign.case import cases_of
from litsim_eval.campaign.criteria import SAFETY, Criteria
from litsim_eval.campaign.results import judge
from litsim_eval.campaign.suite import Suite
from litsim_eval.runs.case_run import plan_of
from litsim_eval.runs.in_process import record
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import Scenario

ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT / "examples/suites/hard_cases.yaml"
SEED, SECONDS = 477938, 12  # drawn as by tools/draw_seeds.py once the kinds were there; of a case after its history
TRAFFIC = {"motorway": ("us101_like", 300, 15), "street": ("urban_like", 600, 10)}  # net, seconds, between pieces
WINDOWS = {"us101": ("us101_0750", "benchmarks/search/us101_748_828.yaml")}  # scenarios by site
STREETS = "streets"  # site and folder of the windows that examples/streets makes
EACH, CALM = 8, 5  # most cases of a kind, and of those in which nobody touches the ego `idm`
PROGRESS = 0.5  # of the log's that the careful driver must make at least
HELD = {"walker", "cyclist", "red light", "amber light"}  # kinds in which it has to stop where the log need not
HELD_PROGRESS = 0.1  # that it must make there
TRIES = 30  # most candidates of a kind


def synthesize(folder: Path) -> dict[str, Path]:
    """Generates the traffic and cuts it into pieces; returns their scenario files by name."""
    files = dict[str, Path]()
    for name, (net, seconds, stride) in TRAFFIC.items():
        recording = folder / f"{name}.parquet"
        if not recording.is_file():
            words = ["--net", net, "--seconds", str(seconds), "--seed", str(SEED)]
            data(["synthesize", *words, "--out", str(recording)])
        cut = ["--simulation", str(SECONDS), "--stride", str(stride), "--split", "1", "0", "0"]
        if not (folder / name).is_dir():
            data(["segments", str(recording), "--out", str(folder / name), *cut])
        files |= {path.stem: path for path in sorted((folder / name).glob(f"{name}_*.yaml"))}
    return files


def windows(folder: Path) -> dict[str, str]:
    """Returns the scenario files of recorded traffic by name; none without LITSIM_DATA."""
    if "LITSIM_DATA" not in os.environ:
        return {}
    streets = folder / STREETS
    if not streets.is_dir():
        subprocess.run([sys.executable, ROOT / "examples/streets/windows.py", streets], check=True, capture_output=True)
    files = {f"{STREETS}/{path.stem}": str(path) for path in sorted(streets.glob("*/*_train_*.yaml"))}
    for site, names in WINDOWS.items():
        files |= {f"{site}/{Path(name).stem}": str(ROOT / name) if "/" in name else name for name in names}
    return files


def write_case(case: Mapping[str, Any], file: Path | str, folder: Path) -> None:
    """Writes the scenario of a case, whose piece of traffic has a scenario file."""
    scenario, name = Scenario.load(file), case["name"]
    values = yaml.safe_load(scenario.to_yaml())  # with absolute paths
    values |= {"name": name, "ego": case["ego"], "changes": case.get("changes", [])}
    for field in ("egos", "tuning", "description"):
        values.pop(field, None)
    path = folder / "cases" / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    if "walker" in case:
        with_walker(scenario.recording, case["walker"]).write(path.with_suffix(".parquet"))
        values |= {"recording": path.with_suffix(".parquet").name}
    path.write_text(yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=120))


def with_walker(recording: Recording, walker: Mapping[str, Any]) -> Recording:
    """Returns a recording with a pedestrian or cyclist who stands: `kind`, `x`, `y`, `yaw`."""
    kind = Kind[walker["kind"].upper()]
    (size,) = (size for of, _, *size in WALKERS.values() if of == kind)
    columns = recording.columns
    frames = np.arange(columns["frame"].min(), columns["frame"].max() + 1)
    mine = {name: np.zeros(len(frames), values.dtype) for name, values in columns.items()}
    fixed = {"vehicle_id": columns["vehicle_id"].max() + 1, "kind": kind, "lane": -1}
    fixed |= dict(zip(("length", "width"), size, strict=True)) | {name: walker[name] for name in ("x", "y", "yaw")}
    for name, value in (fixed | {"frame": frames}).items():
        mine[name][:] = value
    joined = {name: np.concatenate([values, mine[name]]) for name, values in columns.items()}
    order = np.lexsort((joined["vehicle_id"], joined["frame"]))
    return Recording(recording.header, {name: values[order] for name, values in joined.items()})


def suite_of(entries: Sequence[Mapping[str, Any]], folder: Path) -> Path:
    """Writes the suite of cases, each of which has a name, and returns its file."""
    cases = [
        {"scenario": f"cases/{case['name']}.yaml", "ego_id": case["ego"], "tags": [case["kind"]]} for case in entries
    ]
    path = folder / "hard.yaml"
    path.write_text(yaml.safe_dump({"name": "hard", "egos": ["idm"], "cases": cases}, sort_keys=False))
    return path


def all_candidates(files: Mapping[str, Path | str]) -> Iterator[Candidate]:
    """Yields the candidates of all pieces of traffic, generated and recorded."""
    for number, (piece, file) in enumerate(files.items()):
        scenario, random = Scenario.load(file), np.random.default_rng([SEED, number])
        site = piece.partition("/")[0]
        if site != piece:
            for ego, what in recorded(scenario):
                yield {"piece": piece, "ego": ego, "kind": f"recorded, {site}", **what}
            continue
        of_egos = [
            (kind, ego, what) for ego in possible_egos(scenario) for kind, what in candidates(scenario, ego, random)
        ]
        for kind, ego, what in [*of_egos, *encounters(scenario)]:
            yield {"piece": piece, "ego": ego, "kind": kind, **what}


def choose(files: Mapping[str, Path | str], folder: Path) -> list[dict[str, Any]]:
    """Returns the cases: of each kind the first EACH random candidates that are taken.

    What became of the candidates is kept in the folder, and not run again.
    """
    by_kind: dict[str, list[Candidate]] = {}
    for candidate in all_candidates(files):
        by_kind.setdefault(candidate["kind"], []).append(candidate)
    store = folder / "tried.jsonl"
    known = dict(map(json.loads, store.read_text().splitlines())) if store.is_file() else {}
    chosen = []
    for kind, some in by_kind.items():
        of_kind, calm, tried, failed = list[dict[str, Any]](), 0, 0, 0
        for k in np.random.default_rng(SEED).permutation(len(some))[:TRIES].tolist():
            if len(of_kind) == EACH:
                break
            tried += 1
            if (key := json.dumps(some[k])) not in known:
                case = some[k] | {"name": f"{name_of(kind)}_{k}"}
                known[key] = collides_in(case, files[case["piece"]], folder / "tries")
                with store.open("a") as file:
                    file.write(json.dumps([key, known[key]]) + "\n")
            failed += known[key] is None
            if known[key] is None or (not known[key] and calm >= CALM):
                continue
            calm += not known[key]
            name = f"{name_of(kind)}_{len(of_kind):02d}"
            of_kind.append({"name": name, **some[k], "replay_collides": known[key]})
        print(
            f"{kind}: {len(some)} candidates, {tried} tried, the careful driver cannot {failed}; "
            f"{len(of_kind)} taken, {calm} calm",
            flush=True,
        )
        chosen += of_kind
    return chosen


def name_of(kind: str) -> str:
    """Returns a kind of case as part of a file's name."""
    return kind.replace(",", "").replace(" ", "_")


def collides_in(case: Mapping[str, Any], file: Path | str, folder: Path) -> bool | None:
    """Returns whether `idm` has a contact with the traffic on its log; None if the careful driver fails."""
    write_case(case, file, folder)
    suite = Suite.load(suite_of([case], folder)).model_copy(update={"policies": ["replay"]})
    plan = plan_of(cases_of(suite)[0])
    careful = compute_metrics(record(plan, ego=planted(plan.scenario, CAREFUL)))
    safe = all(result.passed for result in judge(careful, Criteria.load(SAFETY)))
    needed = HELD_PROGRESS if case["kind"] in HELD else PROGRESS
    if not safe or careful["ego_motion"]["progress_ratio"] < needed:
        return None
    collision = compute_metrics(record(plan))["collision"]
    return bool(collision["ego_at_fault"] + collision["background_at_fault"])


def main() -> None:
    """Makes the suite."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--choose", action="store_true", help="choose the cases anew")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, Path | str] = {**synthesize(folder), **windows(folder)}
    if arguments.choose:
        chosen = choose(files, folder)
        lines = [yaml.safe_dump(case, sort_keys=False, default_flow_style=True, width=10**6) for case in chosen]
        CASES.write_text("".join(f"- {line}" for line in lines))
    listed = yaml.safe_load(CASES.read_text())
    cases = [case for case in listed if case["piece"] in files]
    for case in cases:
        write_case(case, files[case["piece"]], folder)
    print(f"{suite_of(cases, folder)}: {len(cases)} cases, {sum(case['replay_collides'] for case in cases)} not calm")
    if len(cases) < len(listed):
        print(f"{len(listed) - len(cases)} cases of recorded traffic are left out: LITSIM_DATA names none")


if __name__ == "__main__":
    main()
