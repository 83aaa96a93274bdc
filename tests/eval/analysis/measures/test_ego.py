"""How the ego drove, beside its log."""

from litsim_eval.analysis.measures.ego import ego_motion, minimum_risk_s
from litsim_eval.analysis.measures.progress import mean_progress
from litsim_sim.core.scene import AgentTable
from litsim_sim.scenario.scenario import packaged
from made_runs import make_run, table

NET = packaged("nets/us101_like.net.xml")
EDGE = 0.0  # [m] y of the left edge of that net


def ways(y: list[float], acceleration: list[float] | None = None) -> list[AgentTable]:
    """The ego at each of `y`, driving along +x; its box is 4 m by 2 m."""
    felt = acceleration or [0.0] * len(y)
    return [
        table(i, {"id": 1, "x": 50.0 + i, "y": at, "acceleration": a})
        for i, (at, a) in enumerate(zip(y, felt, strict=True))
    ]


def test_shares_of_steps_off_the_road_and_over_its_edge() -> None:
    driven = ways([EDGE + 9.0, EDGE - 1.8, EDGE - 1.1, EDGE - 0.9, EDGE + 0.5])  # step 0 is history
    run = make_run(driven, log=ways([EDGE - 1.8] * 5), net_xml=NET.read_bytes())
    found = ego_motion(run)
    assert (found["off_road"], found["over_edge"]) == (0.25, 0.5)
    assert found["log"] == {"off_road": 0.0, "over_edge": 0.0, "hard_brakes": 0, "progress_m": 4.0}


def test_hard_brakes_of_the_ego_and_of_its_log() -> None:
    y = [EDGE - 5.0] * 6
    driven, log = ways(y, [0.0, -4.0, -4.0, 0.0, -3.5, 0.0]), ways(y, [0.0, -4.0, 0.0, 0.0, -2.0, 0.0])
    found = ego_motion(make_run(driven, log=log))
    assert (found["hard_brakes"], found["log"]["hard_brakes"]) == (2, 1)
    assert found["off_road"] is None, "without a net nobody knows"


def test_only_steps_after_the_history_count() -> None:
    driven = ways([EDGE + 1.0, EDGE + 1.0, EDGE - 1.8, EDGE + 1.0])
    found = ego_motion(make_run(driven, net_xml=NET.read_bytes(), history_steps=2, total_steps=3))
    assert found["off_road"] == 1.0


def test_an_ego_that_is_gone_has_no_motion() -> None:
    found = ego_motion(make_run([table(0, {"id": 2, "x": 50.0, "y": -5.0})], net_xml=NET.read_bytes()))
    nothing = dict.fromkeys(("off_road", "over_edge", "hard_brakes", "progress_m", "progress_ratio"))
    assert found == nothing | {"log": found["log"]}


def test_progress_of_the_ego_over_that_of_its_log() -> None:
    log = [table(k, {"id": 1, "x": 50.0 + 2 * k, "y": 0.0}) for k in range(5)]
    driven = [table(k, {"id": 1, "x": 50.0 + 0.5 * k, "y": 0.0}) for k in range(5)]  # the way begins at step 0
    run = make_run(driven, log=log)
    found = ego_motion(run)
    assert (found["progress_m"], found["log"]["progress_m"]) == (2.0, 8.0)
    ways = (steps.after(run.info.history_steps - 1) for steps in (run.steps, run.logged))
    assert mean_progress(*ways, {1}) == 2.0, "the same distance as in the progress of all"
    assert found["progress_ratio"] == 0.25


def test_progress_after_the_log_has_left_does_not_count() -> None:
    log = [table(k, *([{"id": 1, "x": 50.0 + 2 * k, "y": 0.0}] if k < 3 else [])) for k in range(5)]
    driven = [table(k, {"id": 1, "x": 50.0 + k, "y": 0.0}) for k in range(5)]
    found = ego_motion(make_run(driven, log=log))
    assert (found["progress_m"], found["progress_ratio"]) == (4.0, 0.5)


def test_who_stands_where_the_log_stood_keeps_up() -> None:
    standing = [table(k, {"id": 1, "x": 50.0, "y": 0.0}) for k in range(3)]
    assert ego_motion(make_run(standing))["progress_ratio"] == 1.0


def test_time_of_minimum_risk_manoeuvres() -> None:
    driven = [table(k, {"id": 1, "x": 50.0 + k, "y": 0.0}) for k in range(21)]
    normal, operating, succeeded = 1, 2, 3
    told = {0: normal, 8: operating, 12: succeeded, 15: normal}
    assert minimum_risk_s(make_run(driven, history_steps=9, minimum_risk=told)) == 0.5  # steps 10 to 14
    assert minimum_risk_s(make_run(driven, history_steps=9, minimum_risk={0: normal})) == 0.0
    assert minimum_risk_s(make_run(driven)) is None
