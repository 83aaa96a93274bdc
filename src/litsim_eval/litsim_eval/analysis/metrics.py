"""All measures of a run as one tree, written to `metrics.json`."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Set
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from litsim_data.surrogates.encroachment import encroachments
from litsim_data.surrogates.safety import TTC_CRITICAL_S, safety_series, shortest_own_ttc
from litsim_eval.analysis.collision import Collisions, collisions
from litsim_eval.analysis.comfort import comfort, hard_brakes_in_log
from litsim_eval.analysis.displacement import Displacements, displacements
from litsim_eval.analysis.driven_traffic import driven_traffic
from litsim_eval.analysis.ego import ego_motion, minimum_risk_s
from litsim_eval.analysis.fault import ContactVerdict, contact_verdicts, count_faults
from litsim_eval.analysis.lockstep import lockstep, problems
from litsim_eval.analysis.metric import measure_added
from litsim_eval.analysis.metrics_tree import (
    CollisionMetrics,
    ComfortMetrics,
    EndMetrics,
    Guard,
    HandbackMetrics,
    Metrics,
    RealismMetrics,
    SafetyMetrics,
    SignalMetrics,
)
from litsim_eval.analysis.progress import mean_progress
from litsim_eval.analysis.reactsim import reactsim
from litsim_eval.analysis.realism import Naturalness
from litsim_eval.analysis.signals import log_passages, run_passages
from litsim_eval.analysis.sim_agents import sim_agents
from litsim_eval.analysis.standoff import standoffs
from litsim_eval.analysis.takeover import Handback, Jump, handbacks, ledger
from litsim_eval.analysis.timing import timing
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Controller, ControlSource, Kind
from litsim_sim.io.files import replacing
from litsim_sim.record.digest import RunDigest
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

METRICS_FILE = "metrics.json"
ROI_M = 30.0  # [m] default of a scenario without `roi_m`


def compute_metrics(run: Run) -> dict[str, Any]:
    """Returns every measure of a run: the tree of :class:`litsim_eval.analysis.metrics_tree.Metrics`.

    Measures cover the steps after the history. Rates are shares between 0 and 1; a measure with nothing to measure is
    None. Agents exclude the ego, except in `collision` and in progress.
    """
    hits, apart, entries = run.once(collisions), displacements(run), run.once(ledger)
    driven, logged = (steps.after(run.info.history_steps - 1) for steps in (run.steps, run.logged))
    verdicts = contact_verdicts(run, hits)
    background = hits.agents - {run.info.ego_id}
    taken_over = {entry.agent for entry in entries}
    near = {
        entry.agent for entry in entries if entry.ego_distance_m is not None and entry.ego_distance_m <= roi_of(run)
    }
    beside = _near_ego_in_log(run)
    lines = run.once(run_passages) or (), run.once(log_passages)
    natural = Naturalness(
        run.simulated, run.simulated_log, hits.controlled | beside, lane_map_of(run), run.info.dt, *lines
    )
    wrong = problems(run)
    metrics: Metrics = {
        "run_id": run.info.run_id,
        "scenario": run.info.scenario,
        "ego": run.info.ego,
        "policy": run.info.policy,
        "seed": run.info.seed,
        "steps": run.tables[-1].step,
        "total_steps": run.info.total_steps,
        "ended": _ended(run),
        "agents": len(background),
        "controlled_agents": len(hits.controlled),
        "digest": digest(run),
        "collision": _collision(run, hits, verdicts),
        "reactive": not hits.excess,
        "collision_free": not hits.first,
        "ade_controlled_m": _by_horizon(apart, apart.ade_controlled),
        "ade_all_m": _by_horizon(apart, apart.ade_all),
        "ade_ego_m": _by_horizon(apart, apart.ade_ego),
        "displacement": {
            "agent_steps": {str(horizon): apart.agent_steps(horizon) for horizon in apart.horizons},
            "agents": apart.by_agent(),
        },
        "ego_motion": ego_motion(run),
        "off_road_controlled": _off_road_controlled(run),
        "replay_error_max_m": max(apart.replay_error().values(), default=None),
        "progress_m": mean_progress(driven, logged),
        "progress_controlled_m": mean_progress(driven, logged, hits.controlled),
        "progress_log_m": mean_progress(logged, logged),
        "relevant_ratio": _share(len(taken_over & background), len(background)),
        "relevant_ratio_roi": _share(len(near & background), len(background)),
        "takeovers": len(entries),
        "false_alarms": sum(entry.false_alarm for entry in entries),
        "detection": {
            "max_iterations": max((d.iterations for d in run.detections.values()), default=0),
            "bound_hits": sum(not d.converged for d in run.detections.values()),
        },
        "ledger": [asdict(entry) for entry in entries],
        "handback": _handback(handbacks(run)),
        "safety": _safety(run, verdicts),
        "comfort": _comfort(run, hits),
        "realism": _realism(natural, hits.controlled, signals=run.signals is not None),
        "realism_near": None if (near_ego := natural.of(beside)) is None else near_ego.score,
        "sim_agents": sim_agents(run, hits, natural.run, natural.log),
        "reactsim": reactsim(run, hits),
        "traffic": driven_traffic(run, hits.controlled),
        "signals": _signals(run),
        "minimum_risk_s": minimum_risk_s(run),
        "standoffs": [asdict(each) for each in standoffs(run)],
        "lockstep": lockstep(run),
        "timing": timing(run),
        "world": {
            "late_entries": run.summary.get("late_entries"),
            "never_entered": run.summary.get("never_entered"),
            "sumo_deviation_m": run.summary.get("sumo_deviation_m"),
        },
        "added": measure_added(run),
        "valid": not wrong,
        "why": "; ".join(wrong),
    }
    return dict(metrics)


def roi_of(run: Run) -> float:
    """Returns the radius [m] of the region of interest of the run's scenario."""
    return float(run.scenario.get("roi_m", ROI_M))


def digest(run: Run) -> str:
    """Returns the digest of a run; equals the in-process runner's for an equal run."""
    total = RunDigest()
    for table in run.tables:
        total.update(table, run.controls.get(table.step), run.ego_commands.get(table.step))
    return total.hexdigest()


def write_metrics(metrics: dict[str, Any], path: Path) -> None:
    """Writes `metrics` as JSON.

    Raises:
        InputError: `path` cannot be written, or a measure is not finite.
    """
    try:
        text = json.dumps(metrics, indent=2, allow_nan=False) + "\n"
    except ValueError as error:
        first, *others = _not_finite(metrics)
        named = f"{first} and {len(others)} more" if others else first
        because = f": {metrics['why']}" if metrics.get("why") else ""
        raise InputError(f"{path}: {named} not finite, expected finite numbers{because}") from error
    with replacing(path) as new:
        new.write_text(text)


def _not_finite(value: Any, name: str = "") -> Iterator[str]:
    """Yields paths of the numbers in the tree `value`, which is at `name`, that are not finite, joined by dots."""
    if isinstance(value, dict | list):
        for key, below in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _not_finite(below, f"{name}.{key}" if name else str(key))
    elif isinstance(value, float) and not np.isfinite(value):
        yield name


def _ended(run: Run) -> EndMetrics | None:
    """Returns why and when the run ended; None if the recording does not say."""
    end = run.ended
    if end is None:
        return None
    time_s = round(end.step * run.info.dt, 6)
    return {"reason": str(end.reason), "step": end.step, "time_s": time_s, "lane": end.lane}


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _by_horizon(far: Displacements, measure: Callable[[int], float | None]) -> dict[str, float | None]:
    return {str(horizon): measure(horizon) for horizon in far.horizons}


def _collision(run: Run, hits: Collisions, verdicts: list[ContactVerdict]) -> CollisionMetrics:
    kinds = {
        agent: int(own.stacked.kind[own.track(agent)[-1]])
        for group, own in run.simulated.groups(hits.colliding)
        for agent in group
    }
    new = [each.contact for each in verdicts if not each.in_log]
    touching = [{kinds[agent] for agent in pair} for pair in hits.first]
    return {
        "agents": len(hits.colliding),
        "pairs": len(hits.first),
        "rate_all": _share(len(hits.colliding), len(hits.agents)),
        "rate_controlled": _share(len(hits.colliding & hits.controlled), len(hits.controlled)),
        "excess_agents": len(hits.colliding_beyond_log),
        "excess_rate_all": _share(len(hits.colliding_beyond_log), len(hits.agents)),
        "excess_rate_controlled": _share(len(hits.colliding_beyond_log & hits.controlled), len(hits.controlled)),
        "ego_at_fault": sum(contact.ego_at_fault for contact in new),
        "background_at_fault": sum(not contact.ego_at_fault for contact in new),
        "by_fault": count_faults(run, hits, verdicts),
        "log_floor": len(hits.log),
        "excess": len(hits.excess),
        "by_kind": {kind.name.lower(): sum(int(kind) in pair for pair in touching) for kind in Kind},
        "contacts": [
            {"pair": list(each.pair), "step": each.first, "last_step": each.last, "in_log": in_log}
            for each, in_log in zip(hits.contacts, hits.in_log, strict=True)
        ],
        "ego_contacts": [
            {
                "agent": each.contact.agent,
                "step": each.contact.step,
                "in_log": each.in_log,
                "verdict": each.contact.verdict.value,
                "ego_at_fault": each.contact.ego_at_fault,
                "delta_v_mps": each.contact.delta_v,
            }
            for each in verdicts
        ],
    }


def _safety(run: Run, verdicts: list[ContactVerdict]) -> SafetyMetrics:
    """Returns surrogate measures of the ego, and the verdicts of the careful driver on each of its contacts."""
    tables, ego = run.simulated, run.info.ego_id
    series = safety_series(tables, ego)
    near = encroachments(tables, ego)
    return {
        "min_ttc_s": _finite(series.ttc.min(initial=np.inf)),
        "min_own_ttc_s": _own_ttc(run, verdicts, float(series.ttc.min(initial=np.inf))),
        "ttc_below": {str(limit): _mean(series.ttc < limit) for limit in TTC_CRITICAL_S},
        "min_headway_s": _finite(series.headway.min(initial=np.inf)),
        "max_drac_mps2": float(series.drac[np.isfinite(series.drac)].max(initial=0.0)),
        "min_pet_s": near[0].pet if near else None,
        "careful_driver": [
            {
                "agent": each.own.agent,
                "step": each.own.contact_step,
                "perceived_step": each.own.perceived_step,
                "avoided": each.own.avoided,
                "other_perceived_step": None if each.other is None else each.other.perceived_step,
                "other_avoids": None if each.other is None else each.other.avoided,
            }
            for each in verdicts
        ],
        "avoidable_contacts": sum(each.own.avoided and not each.in_log for each in verdicts),
    }


def _own_ttc(run: Run, verdicts: list[ContactVerdict], shortest: float) -> float | None:
    """Returns the shortest time to collision [s] that the ego causes: 0 for a contact at its fault.

    Other agents count until their contact. Those that the ego touches in the log too do not count: their recorded
    boxes are too large, or too close.

    `shortest` is that with any agent [s]; inf for none.
    """
    if any(each.contact.ego_at_fault and not each.in_log for each in verdicts):
        return 0.0
    touched = {each.contact.agent: 0 if each.in_log else each.contact.step for each in verdicts}
    return _finite(shortest_own_ttc(run.simulated, run.info.ego_id, touched) if touched else shortest)


def _comfort(run: Run, hits: Collisions) -> ComfortMetrics:
    """Returns the comfort of the ego and, summarised, of the agents ever under control, with their guarded commands.

    Of the agents' hard brakes only those begun under control count; the others are the recording's.
    """
    ego = comfort(run.simulated.only([run.info.ego_id]), run.info.ego_id, run.info.dt)
    others, brakes_in_log = [], 0
    for group, own in run.simulated.groups(hits.controlled):
        log = run.simulated_log.only(group)
        others += [felt for agent in group if (felt := comfort(own, agent, run.info.dt)) is not None]
        brakes_in_log += sum(hard_brakes_in_log(own, log, agent) for agent in group)
    return {
        "ego": {"within": ego.within, "hard_brakes": ego.hard_brakes} if ego else None,
        "controlled": {
            "comfortable": _share(sum(each.comfortable for each in others), len(others)),
            "hard_brakes": sum(each.hard_brakes_driven for each in others),
            "hard_brakes_log": brakes_in_log,
            "guarded": _guard(run),
        },
    }


def _guard(run: Run) -> Guard:
    """Counts the commands of the policy that were applied, and those of them that its safety layer changed.

    Applied are the answers to all steps after the history but the last. Hand-backs and baselines have no guard.
    """
    last = run.tables[-1].step
    counts = Counter[int]()
    for step in run.controls:
        if run.info.history_steps <= step < last:
            counts.update(run.controls[step].source.tolist())
    changed, unchanged = counts[ControlSource.GUARDED], counts[ControlSource.POLICY]
    return {"count": changed, "commands": changed + unchanged, "share": _share(changed, changed + unchanged)}


def _off_road_controlled(run: Run) -> float | None:
    """Returns the share of agent-steps under control with the box centre on no lane; None without any, or a net."""
    lane_map, off_road = lane_map_of(run), np.empty(0, np.bool_)
    if lane_map is None:
        return None
    for part in run.simulated.parts():
        table = part.stacked
        x, y = table.x[table.of_policy], table.y[table.of_policy]
        off_road = np.append(off_road, ~lane_map.inside_road(x, y))
    return _mean(off_road)


def _realism(natural: Naturalness, controlled: Set[int], *, signals: bool) -> RealismMetrics | None:
    """Returns the likelihood of the agents ever under control, under the histograms of the log."""
    likelihood = natural.of(controlled)
    if likelihood is None:
        return None
    lights = "judged" if "traffic_light_violation" in likelihood.features else "no stop line passed"
    return {
        "score": likelihood.score,
        "features": likelihood.features,
        "traffic_lights": lights if signals else "no signals",
        "agent_steps": likelihood.steps,
    }


def _near_ego_in_log(run: Run) -> set[int]:
    """Returns agents whose logs enter the region of interest around the ego's log; the same for every policy."""
    near: set[int] = set()
    for logged in run.simulated_log.parts():
        table = logged.stacked
        ego = logged.rows_of(np.array([run.info.ego_id]))[table.number, 0]
        apart = np.hypot(table.x - table.x[ego], table.y - table.y[ego])
        near |= set(table.id[(ego >= 0) & (apart <= roi_of(run))].tolist())
    return near - {run.info.ego_id}


def _signals(run: Run) -> SignalMetrics | None:
    """Stops lines passed by all agents, and passed at red by the ego, by agents under control, and in the recording."""
    passed = run.once(run_passages)
    if passed is None:
        return None
    red = [each for each in passed if each.at_red]
    return {
        "passed": len(passed),
        "red_ego": sum(each.agent == run.info.ego_id for each in red),
        "red_controlled": sum(each.controller == Controller.POLICY for each in red),
        "red_log": sum(each.at_red for each in run.once(log_passages)),
        "reds": [
            {
                **{name: getattr(passage, name) for name in ("agent", "step", "connection", "group")},
                "by": passage.controller.name.lower(),
            }
            for passage in red
        ],
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if len(values) else None


def _handback(back: list[Handback]) -> HandbackMetrics:
    largest, noise = Jump(), Jump()
    for each in back:
        largest, noise = largest.largest(each.jump), noise.largest(each.log_jump)
    residuals = [each.residual for each in back if each.residual is not None]
    return {
        "count": len(back),
        "max_position_jump_m": largest.position,
        "max_speed_jump_mps": largest.speed,
        "max_yaw_jump_rad": largest.yaw,
        "residual_m": float(np.mean(residuals)) if residuals else None,
        "max_residual_m": max(residuals, default=None),
        "log_position_jump_m": noise.position,
        "log_speed_jump_mps": noise.speed,
        "log_yaw_jump_rad": noise.yaw,
    }
