"""ADE paired over the same agents and steps, shares that count failures, spreads and intervals; on numbers known."""

from typing import Any

import pytest

from litsim_research.paper.measures import Part, ade_parts, count, figure, interval, run_parts

HORIZONS = ("5", "10")


def key(ego: int, draw: int = 0) -> Any:
    return "road", ego, "bat", draw


def agent(name: int, driven_s: float | None, ade: float, steps: int = 50) -> dict[str, Any]:
    """Off its log by `ade` on average, over `steps` up to 5 s and twice as many up to 10 s."""
    return {
        "agent": name,
        "controlled_s": driven_s,
        "steps": {"5": steps, "10": 2 * steps},
        "ade_m": {"5": ade, "10": ade},
    }


def run(*agents: dict[str, Any], steps: int = 500, horizons: tuple[str, ...] = HORIZONS) -> dict[str, Any]:
    every = {horizon: steps * (k + 1) for k, horizon in enumerate(horizons)}
    return {"displacement": {"agent_steps": every, "agents": list(agents)}}


def test_all_methods_are_measured_over_the_agents_that_any_of_them_drives() -> None:
    """One drives 1 and 2, the other 2 and 3; the first is on its log with 3, and so are both with everybody else."""
    methods = {
        "one": {key(7): run(agent(1, 0.1, 2.0), agent(2, 1.0, 4.0))},
        "other": {key(7): run(agent(2, 0.5, 1.0), agent(3, 2.0, 6.0))},
    }
    parts = ade_parts(methods, 5, "driven")
    assert parts["one"][key(7)] == Part(0, 50 * 2.0 + 50 * 4.0, 150.0)
    assert parts["other"][key(7)] == Part(0, 50 * 1.0 + 50 * 6.0, 150.0)
    everybody = ade_parts(methods, 5, "all")
    assert everybody["one"][key(7)] == Part(0, 300.0, 500.0)
    assert everybody["other"][key(7)].below == 500.0


def test_who_is_driven_later_than_the_horizon_is_not_yet_one_of_them() -> None:
    methods = {"one": {key(7): run(agent(1, 5.1, 2.0), agent(2, 5.0, 1.0))}}
    assert ade_parts(methods, 5, "driven")["one"][key(7)] == Part(0, 50.0, 50.0)
    assert ade_parts(methods, 10, "driven")["one"][key(7)] == Part(0, 300.0, 200.0)


def test_cases_count_that_every_method_has_run_for_so_long() -> None:
    short = run(agent(1, 0.1, 2.0), horizons=("5",))
    methods = {
        "one": {key(7): run(agent(1, 0.1, 2.0)), key(8): run(agent(1, 0.1, 9.0)), key(9): run()},
        "other": {key(7): short, key(8): None, key(9): run()},
    }
    assert set(ade_parts(methods, 5, "driven")["one"]) == {key(7), key(9)}
    assert set(ade_parts(methods, 10, "driven")["other"]) == {key(9)}


def test_a_run_that_failed_is_not_free_of_collisions() -> None:
    parts = run_parts({key(7): {"reactive": True}, key(8): {"reactive": False}, key(9): None}, "reactivity_beyond")
    assert figure(parts).value == pytest.approx(1 / 3)
    assert figure(run_parts({key(9): None}, "progress")) is None


def test_means_are_of_the_runs_that_have_a_value() -> None:
    runs = {key(7): {"relevant_ratio": 0.2}, key(8): {"relevant_ratio": None}, key(9): {"relevant_ratio": 0.4}}
    assert figure(run_parts(runs, "relevant_ours")).value == pytest.approx(0.3)


def test_counts_are_sums() -> None:
    assert count({key(7): {"takeovers": 2}, key(8): None, key(9): {"takeovers": 3}}, "takeovers") == 5


def test_the_spread_is_that_of_the_draws() -> None:
    parts = {key(1, 0): Part(0, 1.0, 1.0), key(2, 0): Part(0, 3.0, 1.0), key(3, 1): Part(1, 4.0, 1.0)}
    measure = figure(parts)
    assert measure.value == pytest.approx(8 / 3)
    assert measure.spread == pytest.approx(2**0.5)  # of 2 and 4
    assert figure({key(1): Part(0, 1.0, 1.0)}).spread is None


def test_the_interval_is_of_the_difference_case_by_case() -> None:
    """Cases differ much; what one method adds to each of them does not, and the interval sees that."""
    ours = {key(k): Part(0, float(k), 1.0) for k in range(20)}
    theirs = {key(k): Part(0, k + 1.0 + 0.1 * (k % 2), 1.0) for k in range(20)}
    low, high = interval(ours, theirs)
    assert 1.0 <= low < 1.05 < high <= 1.1
    same = interval(ours, ours)
    assert same == (0.0, 0.0)
    assert interval({key(1): Part(0, 1.0, 1.0)}, theirs) is None, "one case says nothing of spread"
