"""The way of a step through the graph, from marks that are made up: which part is how long, and that they add up."""

import pytest

from litsim_eval.analysis.measures.timing import pace_text, step_path, timing
from litsim_eval.campaign.criteria import Criterion
from litsim_eval.campaign.results import what_happened
from made_runs import make_run, table

BRIDGE = {"begin": 10.0, "shown": 10.001, "free": 10.004, "answered": 10.020, "complete": 10.021}
MARKS = {
    "bridge": {1: BRIDGE, 2: {name: time + 0.023 for name, time in BRIDGE.items()}},
    "predictor": {1: {"begin": 10.002, "answered": 10.008}},
    "conflict": {1: {"begin": 10.009, "answered": 10.012}},
    "policy": {1: {"begin": 10.0125, "answered": 10.0185}},
    "ego": {1: {"begin": 10.002, "answered": 10.003}},
}
PARTS = {
    "bridge publishes": 0.001,
    "hop to predictor": 0.001,
    "predictor": 0.006,
    "hop to conflict": 0.001,
    "conflict": 0.003,
    "hop to policy": 0.0005,
    "policy": 0.006,
    "wait for ego": 0.0,
    "hop to bridge": 0.0015,
    "recorder": 0.001,
    "world": 0.002,
}


def test_a_step_is_cut_at_its_marks_in_order() -> None:
    path = step_path(1, MARKS)
    assert list(path)[: len(PARTS)] == list(PARTS)
    assert {name: path[name] for name in PARTS} == pytest.approx(PARTS, abs=1e-9)
    assert path["(bridge: standard types and SUMO)"] == pytest.approx(0.003)


def test_the_parts_add_up_to_the_whole_step() -> None:
    path = step_path(1, MARKS)
    assert sum(path[name] for name in PARTS) == pytest.approx(path["whole step"], abs=1e-9)


def test_an_ego_that_is_later_than_the_policy_is_waited_for() -> None:
    path = step_path(1, MARKS | {"ego": {1: {"begin": 10.002, "answered": 10.0195}}})
    assert path["wait for ego"] == pytest.approx(0.001)
    assert path["hop to bridge"] == pytest.approx(0.0005)
    assert step_path(1, {k: v for k, v in MARKS.items() if k != "ego"})["wait for ego"] == 0.0, "an external one"


def test_a_step_that_was_not_marked_by_all_has_no_path() -> None:
    assert step_path(1, {"bridge": MARKS["bridge"]}) == {}
    assert step_path(1, {stage: marks for stage, marks in MARKS.items() if stage != "bridge"}) == {}
    assert all(
        step_path(1, MARKS | {stage: {2: MARKS[stage][1]}}) == {} for stage in ("predictor", "conflict", "policy")
    )
    assert step_path(2, MARKS) == {}, "nobody knows how long the world took"


def test_a_run_tells_the_spread_of_every_part() -> None:
    marks = {stage: dict(each) for stage, each in MARKS.items()}
    for stage in MARKS:
        marks[stage][2] = {name: time + 0.023 for name, time in MARKS[stage][1].items()}
    marks["bridge"][3] = {"begin": 10.048}  # the world took 2 ms longer than the time before
    path = timing(make_run([table(step) for step in range(4)], marks=marks))["path_ms"]
    assert path["world"] == pytest.approx({"min": 2.0, "median": 3.0, "max": 4.0})
    assert path["predictor"]["min"] == pytest.approx(path["predictor"]["max"]) == pytest.approx(6.0)


# Time to answer

SLOW = {"median": 50.0, "p99": 298.0, "max": 400.0}


def test_the_ego_of_the_graph_answers_from_the_publication_of_a_step_on() -> None:
    seconds = [9.0, 0.05, 0.4, None, 0.05]  # of a stack that starts late, and misses an answer
    took = [{} if each is None else {"ego": 10.0 + each} for each in seconds]
    marks = {"bridge": {step: {"shown": 10.0} | each for step, each in enumerate(took)}}
    compute = {"ego": dict.fromkeys(range(5), 0.001)}
    run = make_run([table(step) for step in range(5)], marks=marks, timing=compute)
    assert timing(run)["answer_ms"] == pytest.approx({"median": 50.0, "p99": 393.0, "max": 400.0})


def test_the_ego_in_process_answers_after_its_compute_time() -> None:
    compute = {"ego": {0: 1.0, 1: 0.002, 2: 0.004}}
    run = make_run([table(step) for step in range(3)], timing=compute)
    assert timing(run)["answer_ms"] == pytest.approx({"median": 3.0, "p99": 3.98, "max": 4.0})


def test_a_criterion_may_judge_how_soon_the_ego_answers() -> None:
    limit = Criterion(field="timing.answer_ms.p99", max=100.0)
    slow = {"timing": {"answer_ms": {"median": 50.0, "p99": 393.0, "max": 400.0}}}
    result = limit.of_run(slow)
    assert not result.passed and limit.of_run({"timing": {"answer_ms": {"p99": 99.0}}}).passed
    text = what_happened(result.field, result.value, result.limit, slow)
    assert text == "ego: time to answer, p99 393.00 ms, expected at most 100 ms"


def test_records_of_the_graph_by_an_earlier_version_do_not_tell_when_the_ego_answers() -> None:
    run = make_run([table(step) for step in range(3)], marks=MARKS, timing={"ego": {1: 0.002}})
    assert timing(run)["answer_ms"] == {}
    assert pace_text({"timing": {"answer_ms": {}}}) == pace_text({"timing": {}}) == ""


def test_a_stack_of_whose_answers_one_in_a_hundred_takes_longer_than_a_step_is_too_slow() -> None:
    text = "too slow for 10 Hz: one in 100 answers of the ego takes 298 ms or longer"
    assert pace_text({"timing": {"answer_ms": SLOW}}) == text
    assert pace_text({"timing": {"answer_ms": SLOW | {"p99": 100.0}}}) == "", "in time"
