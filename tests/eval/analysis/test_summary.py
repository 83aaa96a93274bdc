"""What the runs of a variant come to together."""

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
    total = summarise([metrics(), bad, bad])
    assert [total[name] for name in ("background_faults", "ego_faults_avoidable", "ego_faults_unavoidable")] == [
        2,
        4,
        8,
    ]
    total = summarise([metrics(), bad])
    assert (total["runs"], total["invalid"], total["agents"], total["takeovers"]) == (2, 1, 40, 7)
    assert (total["colliding_agents"], total["colliding_runs"], total["excess_pairs"], total["ego_contacts"]) == (
        3,
        1,
        2,
        2,
    )
    assert total["rate_all"] == pytest.approx(0.05) and total["reactive"] == pytest.approx(0.5)
    assert total["relevant_ratio"] == pytest.approx(0.3)
    assert (total["releases"], total["releases_missing"], total["held_s"], total["bound_hits"]) == (2, 2, 17.0, 2)
    assert (total["takeovers_per_run"], total["hard_brakes"], total["off_road"]) == (3.5, 8, 0.1)
    assert (total["guarded"], total["hard_brakes_log"]) == (0.1, 6)


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
    total = summarise(
        [
            metrics(handback={"max_position_jump_m": 0.2, "max_residual_m": None}, replay_error_max_m=None),
            metrics(replay_error_max_m=1e-7),
        ]
    )
    assert (total["max_position_jump_m"], total["max_residual_m"], total["replay_error_max_m"]) == (0.2, 0.4, 1e-7)


def test_what_no_run_measures_is_none() -> None:
    alone = metrics(
        collision={"rate_controlled": None},
        ade_controlled_m={"5": None},
        handback={"max_residual_m": None},
        replay_error_max_m=None,
    )
    total = summarise([alone, alone])
    assert total["max_residual_m"] is None and total["replay_error_max_m"] is None
    assert total["rate_controlled"] is None
    assert total["ade_controlled_m"] == dict.fromkeys(("5", "10", "15", "20", "25"))
    mixed = summarise([alone, metrics(collision={"rate_controlled": 0.5})])
    assert mixed["rate_controlled"] == 0.5, "the mean is over the runs that measure it"


def test_a_displacement_says_how_many_runs_went_on_for_so_long() -> None:
    long = metrics(ade_all_m={"5": 0.5, "10": 1.0}, ade_controlled_m={"5": None, "10": None})
    total = summarise([metrics(), metrics(), long], failed=1)
    assert (total["ade_runs"]["5"], total["ade_runs"]["10"], total["ade_runs"]["15"]) == (3, 1, 0)
    assert (total["ade_all_m"]["10"], total["ade_controlled_m"]["10"]) == (1.0, None)


def test_failed_runs_stay_in_the_denominator_and_are_told() -> None:
    total = summarise([metrics(), metrics(reactive=False)], failed=2)
    assert (total["runs"], total["failed"], total["measured"], total["invalid"]) == (4, 2, 2, 0)
    assert total["reactive"] == 0.25, "a run of which nothing is known is not known to be free of collisions"
    assert total["relevant_ratio"] == pytest.approx(0.2) and total["takeovers"] == 4
    lost = summarise([], failed=3)
    assert (lost["runs"], lost["invalid"], lost["reactive"], lost["rate_all"]) == (3, 0, 0.0, None)


def test_of_runs_of_which_nothing_is_known_nothing_is_said_to_be_zero() -> None:
    known = ("runs", "failed", "measured", "invalid", "reactive")
    lost = {name: value for name, value in summarise([], failed=3).items() if name not in known}
    assert set(lost.pop("ade_runs").values()) == {0}
    assert lost.pop("added") == {}
    branches = [name for name, value in lost.items() if isinstance(value, dict)]
    of_branches = [value for name in branches for value in lost.pop(name).values()]
    assert len(branches) == 5 and {*lost.values(), *of_branches} == {None}


def test_driven_traffic_is_pooled_over_agent_steps_and_its_medians_over_runs() -> None:
    def run(**driven: Any) -> dict[str, Any]:
        return metrics(traffic={"driven": {"following": 0, "headway_below_half_s": None, "headway_s": None} | driven})

    long, short = (
        run(following=n, headway_below_half_s=share, headway_s=s) for n, share, s in ((90, 0.1, 1.0), (10, 1.0, 0.4))
    )
    total = summarise([long, short, run()])
    assert total["traffic_driven"]["headway_below_half_s"] == pytest.approx(0.19)
    assert total["traffic_driven"]["headway_s"] == pytest.approx(0.7)
    assert summarise([run()])["traffic_driven"]["headway_below_half_s"] is None
    older = summarise([long, metrics()])
    assert older["traffic_driven"]["headway_below_half_s"] is None, "one did not measure it"
