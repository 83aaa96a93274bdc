"""The hard suite: cases of generated traffic in which somebody is in the ego's way.

    ./litsim exec python benchmarks/search/hard_suite.py FOLDER             # makes FOLDER/hard.yaml and its scenarios
    ./litsim exec python benchmarks/search/hard_suite.py FOLDER --choose    # also chooses the cases anew

The cases are in `examples/suites/hard_cases.yaml`: a piece of generated traffic, an ego, and what is changed. They are
chosen among random ones of each kind by two runs with the traffic on its log: the careful driver must pass, and go half
as far as the recorded vehicle; and in at most four of a kind nobody touches the ego `idm`. No planted
weakness takes part in that.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from compare import CAREFUL, planted

from litsim_data.cli import main as data
from litsim_data.mining.events import EventKind
from litsim_data.mining.mine import mine, possible_egos
from litsim_eval.analysis.measures.signals import passages
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.campaign.case import cases_of
from litsim_eval.campaign.criteria import SAFETY, Criteria
from litsim_eval.campaign.results import judge
from litsim_eval.campaign.suite import Suite
from litsim_eval.runs.case_run import plan_of
from litsim_eval.runs.runner import Runner, record
from litsim_eval.search.places import Places, agents_by_act
from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import Scenario

CASES = Path(__file__).resolve().parents[2] / "examples/suites/hard_cases.yaml"
SEED, SECONDS = 61, 12  # of the traffic and of the choice; of a case after its history
TRAFFIC = {"motorway": ("us101_like", 150, 15), "street": ("urban_like", 240, 5)}  # net, seconds, between pieces
EACH, CALM = 15, 4  # most cases of a kind, and of those in which nobody touches the ego `idm`
PROGRESS = 0.5  # of the log's that the careful driver must make at least
TRIES = 40  # most candidates of a kind
HARD_MPS2, LONG_S = 6.0, 3.0  # how a leader brakes, and for how long
ROOM_M = (2.0, 10.0)  # [m] left between the ego and a vehicle that cuts in
CYCLIST = {"length": 1.8, "width": 0.6, "speed": 4.0}  # [m], [m/s]
AWAY_M = 25.0  # [m] from the ego's way from which cyclists come
Candidate = dict[str, Any]


def synthesize(folder: Path) -> list[str]:
    """Generates the traffic and cuts it into pieces; returns their scenario files."""
    names = []
    for name, (net, seconds, stride) in TRAFFIC.items():
        recording = folder / f"{name}.parquet"
        if not recording.is_file():
            words = ["--net", net, "--seconds", str(seconds), "--seed", str(SEED)]
            data(["synthesize", *words, "--out", str(recording)])
        cut = ["--simulation", str(SECONDS), "--stride", str(stride), "--split", "1", "0", "0"]
        if not (folder / name).is_dir():
            data(["segments", str(recording), "--out", str(folder / name), *cut])
        names += [str(path) for path in sorted((folder / name).glob(f"{name}_*.yaml"))]
    return names


def candidates(scenario: Scenario, ego: int) -> Iterator[tuple[str, Candidate]]:
    """Yields what may happen to an ego, by kind."""
    log, row, first = scenario.log, scenario.log.row(ego), scenario.history_steps
    steps = np.arange(first + 5, first + 70)
    steps = steps[log.valid[row, steps]]
    around = agents_by_act(scenario.around(ego, None), log, steps) if len(steps) else {}
    for agent, there in list(around.get("brake", {}).items())[:1]:
        at = int(there[len(there) // 3])
        kind = "queue" if log.speed[row, at] < 7.0 else "brake"
        yield kind, changed(act("brake", agent, at, LONG_S, deceleration=HARD_MPS2))
    for agent, there in around.get("cut_in", {}).items():
        place = Places.of(log, np.array([row]), there)
        room = place.ahead[log.row(agent)] - 0.5 * float(log.length[row] + log.length[log.row(agent)])
        near = there[(room > ROOM_M[0]) & (room < ROOM_M[1])]
        if len(near):
            yield "cut_in", changed(act("cut_in", agent, int(near[0]), 2.0))
    leaders = list(around.get("cut_out", {}).items())[:2]
    if len(leaders) == 2:
        (leader, there), (second, _) = leaders
        at = int(there[len(there) // 3])
        stops = act("brake", second, at, LONG_S, deceleration=HARD_MPS2)
        yield "cut_out", changed(stops, act("cut_out", leader, at + 15, 2.0))
    moves = log.speed[row, steps] > 4.0
    if "street" in scenario.name and moves.sum() > 20:
        yield "cyclist", {"cyclist": int(steps[moves][20])}
    if ego in passing(scenario):
        yield "stale lights", changed({"kind": "signals", "later_s": 5.0})


@lru_cache(maxsize=1)
def passing(scenario: Scenario) -> set[int]:
    """Returns the agents that pass a stop line."""
    if scenario.signals is None:
        return set()
    steps = scenario.log.replay(scenario.total_steps).after(scenario.history_steps)
    return {passage.agent for passage in passages(scenario.signals, steps)}


def events(scenario: Scenario) -> Iterator[tuple[str, int, Candidate]]:
    """Yields merges, turns and crossings, the other of each at another pace."""
    for event in mine(scenario, (EventKind.MERGE, EventKind.CROSSING, EventKind.LEFT_TURN)):
        if event.other is not None:
            kind = "merge" if event.kind == EventKind.MERGE else "turn"
            for factor in (0.8, 1.25):
                begin = max(scenario.history_steps, event.step - 40)
                yield kind, event.ego, changed(act("pace", event.other, begin, 5.0, factor=factor))


def act(kind: str, agent: int, step: int, duration_s: float, **more: float) -> dict[str, Any]:
    """Returns a change of a scenario."""
    return {"kind": kind, "agent": agent, "begin_s": round(step * STEP_S, 1), "duration_s": duration_s, **more}


def changed(*changes: Mapping[str, Any]) -> Candidate:
    """Returns a candidate with changes."""
    return {"changes": [dict(change) for change in changes]}


def write_case(case: Mapping[str, Any], name: str, folder: Path) -> Path:
    """Writes the scenario of a case."""
    of = str(case["piece"]).partition("_")[0]
    source = folder / of / f"{case['piece']}.yaml"
    values = yaml.safe_load(source.read_text())
    values |= {"name": name, "ego": case["ego"], "recording": f"../{of}.parquet", "changes": case.get("changes", [])}
    values.pop("egos", None)
    path = folder / "cases" / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    if "cyclist" in case:
        scenario = Scenario.load(source)
        with_cyclist(scenario, case["ego"], case["cyclist"]).write(path.with_suffix(".parquet"))
        values |= {"recording": path.with_suffix(".parquet").name}
    path.write_text(yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=120))
    return path


def with_cyclist(scenario: Scenario, ego: int, step: int) -> Recording:
    """Returns the recording with a cyclist who crosses the ego's logged way where that is at a step."""
    recording, log = load_recording(Path(scenario.file.recording), scenario.file.crop), scenario.log
    row = log.row(ego)
    x, y, yaw = (float(values[row, step]) for values in (log.x, log.y, log.yaw))
    to_left = yaw + 0.5 * np.pi
    frames = np.arange(scenario.start_frame, scenario.start_frame + scenario.total_steps + 1)
    along = CYCLIST["speed"] * STEP_S * (frames - scenario.start_frame - step)
    there = np.abs(along) < AWAY_M
    columns = {name: np.zeros(there.sum(), values.dtype) for name, values in recording.columns.items()}
    fixed = {"vehicle_id": recording.columns["vehicle_id"].max() + 1, "yaw": to_left, "kind": Kind.BICYCLE, "lane": -1}
    for name, value in (CYCLIST | fixed).items():
        columns[name][:] = value
    columns["frame"][:] = frames[there]
    columns["x"][:], columns["y"][:] = (
        start + along[there] * turn for start, turn in ((x, np.cos(to_left)), (y, np.sin(to_left)))
    )
    joined = {name: np.concatenate([values, columns[name]]) for name, values in recording.columns.items()}
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


def choose(pieces: Sequence[str], folder: Path) -> list[dict[str, Any]]:
    """Returns the cases: of each kind the first EACH random candidates that are taken.

    What became of the candidates is kept in the folder, and not run again.
    """
    by_kind: dict[str, list[dict[str, Any]]] = {}
    for name in pieces:
        scenario = Scenario.load(name)
        of_egos = [(kind, ego, what) for ego in possible_egos(scenario) for kind, what in candidates(scenario, ego)]
        for kind, ego, what in [*of_egos, *events(scenario)]:
            by_kind.setdefault(kind, []).append({"piece": Path(name).stem, "ego": ego, "kind": kind, **what})
    store = folder / "tried.jsonl"
    known = dict(map(json.loads, store.read_text().splitlines())) if store.is_file() else {}
    chosen = []
    for kind, some in by_kind.items():
        of_kind, calm, tried = list[dict[str, Any]](), 0, 0
        for k in np.random.default_rng(SEED).permutation(len(some))[:TRIES].tolist():
            if len(of_kind) == EACH:
                break
            tried += 1
            if (key := json.dumps(some[k])) not in known:
                known[key] = collides_in(some[k] | {"name": f"{kind.replace(' ', '_')}_try_{k}"}, folder)
                with store.open("a") as file:
                    file.write(json.dumps([key, known[key]]) + "\n")
            if known[key] is None or (not known[key] and calm >= CALM):
                continue
            calm += not known[key]
            name = f"{kind.replace(' ', '_')}_{len(of_kind):02d}"
            of_kind.append({"name": name, **some[k], "replay_collides": known[key]})
        print(f"{kind}: {len(some)} candidates, {tried} tried, {len(of_kind)} taken, {calm} calm", flush=True)
        chosen += of_kind
    return chosen


def collides_in(case: Mapping[str, Any], folder: Path) -> bool | None:
    """Returns whether `idm` has a contact with the traffic on its log; None if the careful driver fails."""
    write_case(case, case["name"], folder)
    suite = Suite.load(suite_of([case], folder)).model_copy(update={"policies": ["replay"]})
    plan = plan_of(cases_of(suite)[0])
    careful = compute_metrics(record(Runner(plan, ego=planted(plan.scenario, CAREFUL))))
    safe = all(result.passed for result in judge(careful, Criteria.load(SAFETY)))
    if not safe or careful["ego_motion"]["progress_ratio"] < PROGRESS:
        return None
    collision = compute_metrics(record(Runner(plan)))["collision"]
    return bool(collision["ego_at_fault"] + collision["background_at_fault"])


def main() -> None:
    """Makes the suite."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--choose", action="store_true", help="choose the cases anew")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    pieces = synthesize(arguments.folder)
    if arguments.choose:
        chosen = choose(pieces, arguments.folder)
        lines = [yaml.safe_dump(case, sort_keys=False, default_flow_style=True, width=10**6) for case in chosen]
        CASES.write_text("".join(f"- {line}" for line in lines))
    cases = yaml.safe_load(CASES.read_text())
    for case in cases:
        write_case(case, case["name"], arguments.folder)
    print(f"{suite_of(cases, arguments.folder)}: {len(cases)} cases")


if __name__ == "__main__":
    main()
