"""What the runs of a variant come to together."""

from __future__ import annotations

from typing import Any

import pytest

from campaigns import summarised_metrics as metrics
from litsim_eval.analysis.summary import summarise


def test_counts_are_summed_and_rates_averaged() -> None:
    bad = metrics(
        agents=30,
        reactive=False,
        valid=False,
        takeovers=5,
        relevant_ratio=0.4,
        collision={
            "agents": 3,
            "excess": 2,
            "ego_contacts": [{}, {}],
            "by_fault": {"background": 1, "ego_avoidable": 2, "ego_unavoidable": 4},
            "rate_all": 0.1,
        },
    )
    variant = summarise([metrics(), bad, bad])
    assert [variant[name] for name in ("background_faults", "ego_faults_avoidable", "ego_faults_unavoidable")] == [
        2,
        4,
        8,
    ]
    variant = summarise([metrics(), bad])
    assert (variant["runs"], variant["invalid"], variant["agents"], variant["takeovers"]) == (2, 1, 40, 7)
    assert (
        variant["colliding_agents"],
        variant["colliding_runs"],
        variant["excess_pairs"],
        variant["ego_contacts"],
    ) == (3, 1, 2, 2)
    assert variant["rate_all"] == pytest.approx(0.05) and variant["reactive"] == pytest.approx(0.5)
    assert variant["relevant_ratio"] == pytest.approx(0.3)
    assert (variant["releases"], variant["releases_missing"], variant["held_s"], variant["bound_hits"]) == (
        2,
        2,
        17.0,
        2,
    )
    assert (variant["takeovers_per_run"], variant["hard_brakes"], variant["off_road"]) == (3.5, 8, 0.1)
    assert (variant["guarded"], variant["hard_brakes_log"]) == (0.1, 6)


def test_guarded_steps_are_a_share_of_all_steps_not_a_mean_over_runs() -> None:
    def comfort(**guarded: Any) -> dict[str, Any]:
        return {"controlled": {"hard_brakes": 0, "hard_brakes_log": 0, "guarded": guarded}}

    long, idle = comfort(count=0, commands=150, share=0.0), comfort(count=0, commands=0, share=None)
    older = {"controlled": {"hard_brakes": 0, "guarded": {"count": 5, "share": 0.1}}}
    assert summarise([metrics(), metrics(comfort=long), metrics(comfort=idle)])["guarded"] == 5 / 200
    assert summarise([metrics(comfort=idle)])["guarded"] is None
    found = summarise([metrics(), metrics(comfort=older)])
    assert found["guarded"] is None and found["hard_brakes_log"] is None, "one did not measure them"


def test_largest_values_are_kept() -> None:
    variant = summarise(
        [
            metrics(handback={"max_position_jump_m": 0.2, "max_residual_m": None}, replay_error_max_m=None),
            metrics(replay_error_max_m=1e-7),
        ]
    )
    assert (
        variant["max_position_jump_m"] == 0.2
        and variant["max_residual_m"] == 0.4
        and variant["replay_error_max_m"] == 1e-7
    )


def test_what_no_run_measures_is_none() -> None:
    alone = metrics(
        collision={"rate_controlled": None},
        ade_controlled_m={"5": None},
        handback={"max_residual_m": None},
        replay_error_max_m=None,
    )
    variant = summarise([alone, alone])
    assert variant["max_residual_m"] is None and variant["replay_error_max_m"] is None
    assert variant["rate_controlled"] is None
    assert variant["ade_controlled_m"] == dict.fromkeys(("5", "10", "15", "20", "25"))
    mixed = summarise([alone, metrics(collision={"rate_controlled": 0.5})])
    assert mixed["rate_controlled"] == 0.5, "the mean is over the runs that measure it"


def test_a_displacement_says_how_many_runs_went_on_for_so_long() -> None:
    long = metrics(ade_all_m={"5": 0.5, "10": 1.0}, ade_controlled_m={"5": None, "10": None})
    variant = summarise([metrics(), metrics(), long], failed=1)
    assert (variant["ade_runs"]["5"], variant["ade_runs"]["10"], variant["ade_runs"]["15"]) == (3, 1, 0)
    assert (variant["ade_all_m"]["10"], variant["ade_controlled_m"]["10"]) == (1.0, None)


def test_a_table_of_no_runs_is_empty_not_an_error() -> None:
    variant = summarise([])
    assert variant["runs"] == 0 and variant["rate_all"] is None and variant["max_position_jump_m"] is None


def test_failed_runs_stay_in_the_denominator_and_are_told() -> None:
    variant = summarise([metrics(), metrics(reactive=False)], failed=2)
    assert (variant["runs"], variant["failed"], variant["measured"], variant["invalid"]) == (4, 2, 2, 0)
    assert variant["reactive"] == 0.25, "a run of which nothing is known is not known to be free of collisions"
    assert variant["relevant_ratio"] == pytest.approx(0.2) and variant["takeovers"] == 4
    lost = summarise([], failed=3)
    assert (lost["runs"], lost["invalid"], lost["reactive"], lost["rate_all"]) == (3, 0, 0.0, None)


def test_of_runs_of_which_nothing_is_known_nothing_is_said_to_be_zero() -> None:
    known = ("runs", "failed", "measured", "invalid", "reactive")
    lost = {name: value for name, value in summarise([], failed=3).items() if name not in known}
    assert set(lost.pop("ade_runs").values()) == {0}
    assert lost.pop("added") == {}
    by_horizon = [*lost.pop("ade_controlled_m").values(), *lost.pop("ade_all_m").values()]
    assert {*lost.values(), *by_horizon} == {None}
