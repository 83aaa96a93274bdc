"""The paper's two case studies: a lane change on US-101, and an unprotected left turn in a street.

In each, an ego departs from its log and replayed traffic drives into it. The ego is not hand-picked, but the first
candidate that has a contact under replay and none under LitSim. At the left turn, the contact must be with the other
vehicle of the turn, which passes second in the log and meets the ego because the ego is late; other contacts do not
count.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Patch
from matplotlib.transforms import Affine2D

from litsim_data.mining.events import EventKind
from litsim_data.mining.mine import mine
from litsim_data.mining.selection import MinedEvent, hardest
from litsim_data.pictures.plan_view import draw_boxes, draw_lanes
from litsim_data.traffic.seeds import LEFT_TURNS
from litsim_eval.campaign.case import Case
from litsim_eval.campaign.results import Campaign, RunResult
from litsim_eval.campaign.suite import CaseEntry, EgoSetup, Suite
from litsim_eval.runs.case_run import plan_of
from litsim_eval.runs.in_process import record
from litsim_research.paper.experiments import JUDGED, OURS
from litsim_research.paper.measures import key_of
from litsim_research.paper.roads import REAL, URBAN, generated, roads
from litsim_sim.core.colours import colour_of
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, AgentTable, Controller, FloatArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.run import Run
from litsim_sim.scenario.policies import REPLAY
from litsim_sim.scenario.scenario import Scenario

LANE_CHANGE, LEFT_TURN = "lane_change", "left_turn"
STUDIES = {LANE_CHANGE: "Lane change, US-101", LEFT_TURN: "Unprotected left turn, generated street"}
SEGMENTS = 60
"""Number of 28 s segments of generated street searched for left turns."""
QUICK_TURNS = "small"
"""Packaged suite with the left turns of a quick trial."""
EVENTS = {LEFT_TURN: EventKind.LEFT_TURN}
"""Kind of event that the contact under replay must belong to, by study; without one, the ego's first contact counts."""
BEFORE_S = (-3.0, -2.0, -1.0, 0.0)
"""Times of the pictures, relative to the contact under replay [s]."""
AFTER_S = 1.0
VIEW_M = {LANE_CHANGE: (24.0, 12.0), LEFT_TURN: (26.0, 20.0)}
"""Half length and half width of the view around the ego, along its heading at the contact [m]."""
SHOWN = {Controller.EGO: "ego", Controller.POLICY: "driven", Controller.LOG: "log"}
"""Names in the legend, by controller."""


def candidates(name: str, folder: Path, *, quick: bool) -> Suite:
    """Returns the candidate runs for the case study `name`, in order of preference; only a few if `quick`.

    Raises:
        InputError: the real window is missing, or `folder` cannot be written.
    """
    if name == LANE_CHANGE:
        changer = EgoSetup(name="lane_changer", kind="perturbed", parameters={"ego.kind": "lane_change"})
        return _suite(name, roads((REAL,), folder, quick=quick)[REAL], [changer])
    brakers = [
        EgoSetup(name=name, kind="perturbed", parameters={"ego.kind": "brake", "ego.deceleration": deceleration})
        for name, deceleration in (("braker", 3.0), ("hard_braker", 4.0))
    ]
    if quick:
        files = dict.fromkeys(entry.scenario for entry in Suite.load(QUICK_TURNS).cases if name in entry.tags)
    else:
        files = dict.fromkeys(generated(URBAN, SEGMENTS, LEFT_TURNS, folder))
    return _suite(name, left_turns(files), [brakers[0], EgoSetup(name="idm", kind="idm"), brakers[1]])


def _suite(name: str, cases: list[CaseEntry], egos: list[EgoSetup]) -> Suite:
    return Suite(name=name, cases=cases, egos=egos, policies=[REPLAY, OURS], criteria=JUDGED)


def left_turns(scenarios: Iterable[str]) -> list[CaseEntry]:
    """Returns unprotected left turns at which the ego passes first, by ascending post-encroachment time.

    An ego that is later than in its log meets the vehicle that passes second.
    """
    turns = [
        MinedEvent(name, event)
        for name in scenarios
        for event in mine(Scenario.load(name), [EventKind.LEFT_TURN])
        if event.numbers["first"] == "ego"
    ]
    return [
        CaseEntry(scenario=turn.scenario, ego_id=turn.event.ego, tags=[LEFT_TURN], events=[turn.event.entry()])
        for turn in hardest(turns, len(turns))
    ]


@dataclass(frozen=True)
class Study:
    """A case under replay and under LitSim.

    Attributes:
        replay, ours: the case with either policy.
        contact: step of the ego's first contact under replay.
    """

    replay: Case
    ours: Case
    contact: int


def chosen(campaign: Campaign, event: EventKind | None = None) -> Study | None:
    """Returns the first case with a contact of the ego that is not in the log under replay, and none under LitSim.

    LitSim must also take over an agent. With `event`, the ego's first contact must be with the other vehicle of such an
    event. None if there is no such case.
    """
    by_policy: dict[str, dict[object, RunResult]] = {REPLAY: {}, OURS: {}}
    for result in campaign.results:
        by_policy[result.case.policy][key_of(result.case)] = result
    for key, replayed in by_policy[REPLAY].items():
        ours = by_policy[OURS].get(key)
        if ours is None or ours.metrics is None or replayed.metrics is None:
            continue
        step = _ego_contact(replayed, event)
        if step is not None and ours.metrics["reactive"] and ours.metrics["takeovers"]:
            return Study(replayed.case, ours.case, step)
    return None


def _ego_contact(result: RunResult, event: EventKind | None) -> int | None:
    """Returns the step of the ego's first contact that is not in the log; None without, or if of no `event`."""
    case, metrics = result.case, result.metrics or {}
    contacts = metrics["collision"]["contacts"]
    own = [contact for contact in contacts if case.ego_id in contact["pair"] and not contact["in_log"]]
    first = min(own, key=lambda contact: int(contact["step"]), default=None)
    others = {mined["other"] for mined in case.events if mined["kind"] == event}
    if first is None or (event is not None and others.isdisjoint(first["pair"])):
        return None
    return int(first["step"])


def drawn(name: str, study: Study) -> Canvas:
    """Returns a picture of the study `name` at several times, replay above and LitSim below.

    Raises:
        InputError: a run cannot be repeated, or its ego is not there at the contact.
    """
    runs = [record(plan_of(case)) for case in (study.replay, study.ours)]
    lane_map = plan_of(study.ours).scenario.lane_map
    times = [*BEFORE_S, AFTER_S]
    steps = [max(runs[0].info.history_steps, study.contact + round(t / STEP_S)) for t in times]
    wide, high = VIEW_M[name]
    canvas = Canvas((9.5, 2 * (9.5 / len(steps)) * high / wide + 1.0), layout="constrained")
    panels = canvas.subplots(2, len(steps), squeeze=False)
    at_contact = _pose(runs[0], study.contact)
    if at_contact is None:
        raise InputError(f"{runs[0].info.run_id}: no ego at step {study.contact}")
    heading = float(at_contact[2])
    centres = [(at_contact if (pose := _pose(runs[0], step)) is None else pose)[:2] for step in steps]
    for row, (run, label) in enumerate(zip(runs, (REPLAY, OURS), strict=True)):
        for axes, step, middle in zip(panels[row], steps, centres, strict=True):
            _draw(axes, run, lane_map, step, (middle, heading, wide, high))
            axes.set_title(f"{(step - study.contact) * STEP_S:+.1f} s", fontsize=8)
        panels[row][0].set_ylabel(label, fontsize=9)
    marks = [Patch(color=colour_of(controller), label=name) for controller, name in SHOWN.items()]
    canvas.legend(handles=marks, loc="outside lower center", ncols=len(marks), frameon=False)
    where = f"{Path(study.ours.scenario).stem}, ego {study.ours.ego_id} ({study.ours.ego.name})"
    canvas.suptitle(f"{STUDIES[name]}: {where}; times from the contact under replay", fontsize=9)
    return canvas


def _table(run: Run, step: int) -> AgentTable | None:
    """Returns all agents at `step`; None if the run has no such step."""
    return next((table for table in run.tables if table.step == step), None)


def _pose(run: Run, step: int) -> FloatArray | None:
    """Returns the pose (3,) x, y [m], yaw [rad] of the ego at `step`; None if it is gone."""
    table = _table(run, step)
    row = -1 if table is None else table.row(run.info.ego_id)
    return None if table is None or row < 0 else np.array([table.x[row], table.y[row], table.yaw[row]])


def _draw(axes: Axes, run: Run, lane_map: LaneMap, step: int, view: tuple[FloatArray, float, float, float]) -> None:
    """Draws lanes and boxes at `step`; `view` is its centre, the heading to the right, half length and half width."""
    centre, heading, wide, high = view
    seen = Affine2D().translate(*-centre).rotate(-heading) + axes.transData
    draw_lanes(axes, lane_map, transform=seen)
    table = _table(run, step)
    if table is not None:
        draw_boxes(axes, table, [colour_of(controller) for controller in table.controller.tolist()], transform=seen)
    axes.set(xlim=(-wide, wide), ylim=(-high, high), aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
