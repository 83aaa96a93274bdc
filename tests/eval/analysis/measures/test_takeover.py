"""The ledger of takeovers, and jumps at hand-back that are there or not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.measures.takeover import TakeoverOutcome, handbacks, jump, ledger
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.analysis.tables import takeovers_table
from litsim_sim.core.scene import Controller
from litsim_sim.core.takeover import Takeover, TakeoverReason, TakeoverState
from made_agents import takeover
from made_runs import make_run, moved, table

HELD, HANDBACK, RELEASED, OWN_INTENT = TakeoverState


def record(agent: int, state: TakeoverState = HELD, **values: Any) -> Takeover:
    usual: dict[str, Any] = {"detected_step": 5, "residual_position": 1.5, "residual_speed": 0.5}
    return takeover(agent, state=state, **(usual | values))


def follower_log(steps: int = 40) -> list[Any]:
    """Ego 1 ahead of agent 2 by 20 m, both at 10 m/s; agent 3 far off."""
    where = {1: (20.0, 0.0), 2: (0.0, 0.0), 3: (0.0, 50.0)}
    return [table(k, *({"id": a, "x": x + k, "y": y} for a, (x, y) in where.items())) for k in range(steps + 1)]


def with_ego_stopped(log: list[Any], gap: float) -> list[Any]:
    """The ego stays where it is `gap` metres before agent 2's log catches up, from step 5 on."""
    return [t if t.step < 5 else moved([t], 1, x=min(0.0, 25.0 - gap - t.step - 20.0), controller=2)[0] for t in log]


def episode(agent: int, first: int, back: int, last: int) -> dict[int, list[Takeover]]:
    states = {k: HANDBACK if k >= back else HELD for k in range(first, last)} | {last: RELEASED}
    return {k: [record(agent, state, detected_step=first)] for k, state in states.items()}


def test_takeover_that_prevented_a_contact() -> None:
    log = follower_log()
    run = make_run(with_ego_stopped(log, 0.0), log, takeovers=episode(2, 5, 20, 30))
    (entry,) = ledger(run)
    assert (entry.agent, entry.opponent, entry.detected_step) == (2, 1, 5)
    assert (entry.handback_step, entry.released_step) == (20, 30)
    assert entry.held_s == pytest.approx(2.6)
    assert entry.replay_would_collide
    assert entry.replay_opponent == 1
    assert entry.replay_step == 22  # the ego stands at 25 m: the log's box begins to overlap beyond 21 m
    assert not entry.false_alarm
    assert (entry.residual_m, entry.residual_mps) == (1.5, 0.5)


def test_a_takeover_is_held_no_longer_than_the_run_lasts() -> None:
    log = follower_log()
    held = {k: [record(2, HELD, detected_step=17)] for k in range(17, 41)}
    (entry,) = ledger(make_run(log, log, takeovers=held))
    assert (entry.released_step, entry.held_s) == (None, 2.3), "the last step of the run is 23 steps later"


def test_steps_that_a_damaged_record_lacks_make_no_second_takeover() -> None:
    log = follower_log()
    every = episode(2, 5, 20, 30) | episode(2, 33, 35, 38)
    (first, second), damaged = ledger(make_run(log, log, takeovers=every)), []
    for lost in (range(10, 13), range(18, 22), range(28, 32)):
        kept = {k: found for k, found in every.items() if k not in lost}
        damaged.append([(each.detected_step, each.held_s) for each in ledger(make_run(log, log, takeovers=kept))])
    whole = [(5, first.held_s), (33, second.held_s)]
    assert damaged[:2] == [whole, whole]
    assert damaged[2] == [(5, 2.3), whole[1]], "the release is lost, too; another detection is another one"


def test_takeover_without_need_is_a_false_alarm() -> None:
    log = follower_log()
    (entry,) = ledger(make_run(log, log, takeovers=episode(2, 5, 20, 30)))
    assert not entry.replay_would_collide
    assert entry.false_alarm


def test_what_no_forecast_predicted_has_no_time_to_conflict() -> None:
    """The message holds placeholders: 0 s, as if the overlap were now, and a probability of 0 or 1."""
    log = follower_log()
    for reason in TakeoverReason:
        found = record(2, reason=reason, time_to_conflict=0.0, overlap_probability=1.0)
        run = make_run(log, log, takeovers={5: [found]})
        (entry,) = ledger(run)
        expected = (0.0, 1.0) if reason == TakeoverReason.CONFLICT else (None, None)
        assert (entry.time_to_conflict_s, entry.overlap_probability) == expected
        assert entry.false_alarm == (reason == TakeoverReason.CONFLICT)
        rows = takeovers_table(run).to_pylist()
        assert (rows[0]["time_to_conflict_s"], rows[0]["overlap_probability"]) == expected


def test_without_a_logged_pose_there_is_no_residual() -> None:
    log = follower_log()
    (entry,) = ledger(make_run(log, log, takeovers={5: [record(2, residual_position=-1.0)]}))
    assert entry.residual_m is None
    assert entry.residual_mps is None


def test_contacts_before_the_detection_are_no_reason() -> None:
    log = follower_log()
    run = [moved([t], 1, x=-20.0, controller=2)[0] if t.step in (2, 3) else t for t in log]
    (entry,) = ledger(make_run(run, log, takeovers=episode(2, 5, 20, 30)))
    assert not entry.replay_would_collide


def test_an_agent_that_is_taken_over_is_no_obstacle_to_its_own_log() -> None:
    log = follower_log()
    run = moved(log, 2, x=-1.0, controller=Controller.POLICY)
    (entry,) = ledger(make_run(run, log, takeovers=episode(2, 5, 20, 30)))
    assert not entry.replay_would_collide


def test_another_agent_off_its_log_is_an_obstacle() -> None:
    log = follower_log()
    run = moved(log, 3, x=1.0, y=-50.0, controller=Controller.POLICY)
    (entry,) = ledger(make_run(run, log, takeovers=episode(2, 5, 20, 30)))
    assert entry.replay_would_collide
    assert (entry.replay_opponent, entry.replay_step) == (3, 6)


def test_another_agent_on_its_log_with_a_lag_is_an_obstacle() -> None:
    log = follower_log()
    late = moved(log, 3, x=1.0, y=-50.0)  # follows its log, but not where that has it now
    (entry,) = ledger(make_run(late, log, takeovers=episode(2, 5, 20, 30)))
    assert entry.replay_would_collide
    assert (entry.replay_opponent, entry.replay_step) == (3, 6)
    (entry,) = ledger(make_run(log, moved(log, 3, x=1.0, y=-50.0), takeovers=episode(2, 5, 20, 30)))
    assert not entry.replay_would_collide, "agent 3 is nowhere near the log of agent 2"


def test_an_agent_that_is_late_is_compared_with_its_late_log() -> None:
    """Of two takeovers, the first leaves a lag of 10 steps: the log then meets the ego, which stands, 1 s later."""
    log = follower_log()
    first = {k: [replace(each, time_shift=1.0) for each in records] for k, records in episode(2, 2, 3, 4).items()}
    run = with_ego_stopped(log, 0.0)
    entries = ledger(make_run(run, log, takeovers=first | episode(2, 10, 20, 30)))
    assert [each.replay_step for each in entries] == [22, 32]


def test_two_takeovers_of_one_agent_are_two() -> None:
    log = follower_log()
    takeovers = episode(2, 5, 8, 10) | episode(2, 11, 13, 15) | {20: [record(2, detected_step=20)]}
    entries = ledger(make_run(log, log, takeovers=takeovers))
    assert [(e.detected_step, e.released_step) for e in entries] == [(5, 10), (11, 15), (20, None)]


def test_who_drives_by_its_own_intent_at_the_end_is_told_apart() -> None:
    """Held again between, the time before does not count; back on its log later, own intent is no outcome."""
    log = follower_log()
    states = [HELD] * 5 + [OWN_INTENT] * 5 + [HELD] * 5 + [OWN_INTENT] * 21
    records = {5 + k: [record(2, state)] for k, state in enumerate(states)}
    (entry,) = ledger(make_run(log, log, takeovers=records))
    assert (entry.own_intent_step, entry.released_step, entry.outcome) == (20, None, TakeoverOutcome.OWN_INTENT)
    back = {k: [record(2, RELEASED if k == 39 else HANDBACK)] for k in range(36, 40)}
    (entry,) = ledger(make_run(log, log, takeovers={k: of for k, of in records.items() if k < 40} | back))
    assert (entry.own_intent_step, entry.released_step, entry.outcome) == (None, 39, TakeoverOutcome.OFF_LOG)


def handed_back(offset: float, **other: float) -> tuple[list[Any], list[Any]]:
    """Agent 2 under POLICY up to step 20 behind its log by `offset`, and on it from step 21."""
    log = follower_log()
    off = moved(log, 2, x=-offset, controller=Controller.POLICY, **other)
    return [off[k] if k <= 20 else log[k] for k in range(len(log))], log


def test_teleport_at_hand_back_is_measured() -> None:
    (back,) = handbacks(make_run(*handed_back(2.0)))
    assert back.residual == pytest.approx(2.0)
    assert back.jump.position == pytest.approx(2.0)
    assert (back.jump.speed, back.jump.yaw) == (0.0, 0.0)
    assert back.log_jump == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_smooth_return_has_no_jump() -> None:
    log = follower_log(80)
    run = list(log)
    for k in range(61):  # 2 m behind up to step 20, from there on to the log within 4 s, without a jerk
        s = max(0, k - 20) / 40
        left, faster = 2.0 * (1 - s**3 * (10 - 15 * s + 6 * s**2)), 2.0 * 30 * (s * (1 - s)) ** 2 / 4.0
        controller = Controller.POLICY if k <= 20 else Controller.LOG
        run[k] = moved([log[k]], 2, x=-left, speed=faster, controller=controller)[0]
    (back,) = handbacks(make_run(run, log))
    assert back.residual == pytest.approx(2.0)
    assert back.jump.position < 0.001
    assert (back.jump.speed, back.jump.yaw) == (0.0, 0.0)
    assert handbacks(make_run(log, log)) == []


def released_late(offset: float, after: float) -> tuple[list[Any], list[Any], Any]:
    """Agent 2 comes back to its log 1.5 s late: `offset` behind it up to step 30, and off it by `after` from then on.

    Agent 2's log makes a step of 0.5 m to the side between steps 20 and 21, which a late replay shows 15 steps later.
    """
    log = follower_log(80)
    log = [moved([each], 2, y=0.5)[0] if each.step > 20 else each for each in log]
    run = []
    for each in log:
        past = log[max(0, each.step - 15)]
        where = {name: getattr(past, name)[past.row(2)] - getattr(each, name)[each.row(2)] for name in ("x", "y")}
        where["x"] -= offset if each.step <= 30 else after
        controller = Controller.POLICY if each.step <= 30 else Controller.LOG
        run.append(moved([each], 2, controller=controller, **where)[0])
    records = episode(2, 5, 20, 30)
    late = {k: [replace(r, time_shift=1.5) for r in each] for k, each in records.items()}
    return run, log, late


def test_a_return_to_a_late_log_is_measured_against_that() -> None:
    run, log, takeovers = released_late(0.4, 0.0)
    (back,) = handbacks(make_run(run, log, takeovers=takeovers))
    assert back.residual == pytest.approx(0.4), "15 m from where the log would be now"
    assert back.jump.position == pytest.approx(0.4)
    assert back.log_jump == pytest.approx((0.0, 0.0, 0.0), abs=1e-9), "the late log goes straight on at step 30"
    (unknown,) = handbacks(make_run(run, log))
    assert unknown.residual == pytest.approx(np.hypot(15.4, 0.5))


def test_the_noise_of_a_late_log_is_that_of_the_steps_it_replays() -> None:
    """It is looked at until the agent is on its late log, which here it never is."""
    run, log, takeovers = released_late(0.4, 0.3)
    (back,) = handbacks(make_run(run, log, takeovers=takeovers))
    assert back.log_jump.position == back.jump.position == pytest.approx(0.5), "at step 35, as logged at step 20"


def test_a_residual_that_nobody_knows_is_not_nought() -> None:
    run, log = handed_back(2.0)
    over = [each.take(np.flatnonzero(each.id != 2)) if each.step == 20 else each for each in log]
    (back,) = handbacks(make_run(run, over))
    assert back.residual is None
    found = compute_metrics(make_run(run, over))["handback"]
    assert (found["count"], found["residual_m"], found["max_residual_m"]) == (1, None, None)
    (early,) = handbacks(make_run(run, log, takeovers={20: [record(2, RELEASED, time_shift=9.0)]}))
    assert early.residual is None, "the log of 90 steps before is not in the record"


def test_jumps_of_speed_and_yaw_are_measured() -> None:
    (back,) = handbacks(make_run(*handed_back(0.0, speed=-3.0, yaw=0.5)))
    assert back.jump.speed == pytest.approx(3.0 - 0.4)
    assert back.jump.yaw == pytest.approx(0.5 - 0.1 * 4.89 / 8.5)


def test_motion_within_the_vehicle_s_limits_is_no_jump() -> None:
    before = table(0, {"id": 2, "x": 0.0, "y": 0.0, "speed": 10.0})
    after = table(1, {"id": 2, "x": 0.96, "y": 0.0, "speed": 9.2, "yaw": 0.04})
    found = jump(before, after, 2, 0.1)
    assert (found.speed, found.yaw) == (pytest.approx(0.0, abs=1e-9), 0.0)
    assert found.position < 0.03


def test_what_is_measured_at_a_step_is_measured_there_though_others_are_lost() -> None:
    """The ego comes nearer to agent 2 by 0.1 m a step; five steps before the second detection are not in the record."""
    log = follower_log()
    run = [moved([each], 1, x=-0.1 * each.step)[0] for each in log]
    found = {20: [record(2, detected_step=20)], 40: [record(2, detected_step=40)]}
    kept = [k for k in range(len(log)) if not 10 <= k < 15]
    lost = make_run([run[k] for k in kept], [log[k] for k in kept], takeovers=found)
    assert [entry.ego_distance_m for entry in ledger(lost)] == pytest.approx([18.0, 16.0])
    split = make_run(run, log, takeovers={20: found[20], 30: found[20]})
    assert [entry.ego_distance_m for entry in ledger(split)] == pytest.approx([18.0]), "at the detection"
    gone = make_run(run[:40], log[:40], takeovers=found)
    assert [entry.ego_distance_m for entry in ledger(gone)] == [pytest.approx(18.0), None], "step 40 is lost itself"


@pytest.mark.parametrize(
    ("ego", "place"),
    [
        ({"x": 20.0}, "ahead"),
        ({"x": -9.0, "y": 1.0, "yaw": 0.5}, "behind"),
        ({"x": 3.0, "y": -3.2, "yaw": -0.7}, "beside"),
        ({"x": 9.0, "y": 3.2, "yaw": 1.5}, "crossing"),
        ({"x": 9.0, "yaw": -3.0}, "oncoming"),
    ],
)
def test_the_kind_of_an_encounter_is_where_the_other_is(ego: dict[str, float], place: str) -> None:
    run = [table(k, {"id": 1, "y": 0.0} | ego, {"id": 2, "x": 0.0, "y": 0.0}) for k in range(8)]
    (entry,) = ledger(make_run(run, run, takeovers={5: [record(2)]}))
    assert entry.opponent_place == place


def test_steps_that_are_lost_are_no_jump() -> None:
    run, log = handed_back(2.0)
    for gap, returns in (((21, 25), 0), ((22, 25), 1)):
        kept = [k for k in range(len(log)) if not gap[0] <= k < gap[1]]
        backs = handbacks(make_run([run[k] for k in kept], [log[k] for k in kept]))
        assert len(backs) == returns
        assert all(back.jump.position == pytest.approx(2.0) for back in backs), "not 3 m more, the way of three steps"
