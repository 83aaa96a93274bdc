"""Drivers whose ranking is plain, measured as simulated ones are."""

from typing import Any

import pytest

from litsim_eval.credibility.measures import QUANTITIES, measured
from litsim_eval.credibility.responses import Responses
from litsim_eval.credibility.running import Drive
from planted_drivers import PLANTED, made_encounters


@pytest.fixture(scope="module")
def planted() -> dict[str, dict[str, Any]]:
    """Measures of the planted drivers, by name."""
    encounters = made_encounters(30)
    drives = {
        name: [[Drive(driver(encounter), 0.0, contact=False)] for encounter in encounters]
        for name, driver in PLANTED.items()
    }
    return {name: measured(Responses.of(encounters, each)) for name, each in drives.items()}


def test_a_copy_of_the_record_has_no_error(planted: dict[str, dict[str, Any]]) -> None:
    own = planted["copy"]
    errors = ("position_error_m", "across_error_m", "onset_error_s", "politeness_m", "heroism", "contacts")
    assert [own[name] for name in errors] == [0.0] * len(errors)
    assert [own[f"{quantity}_ks"] for quantity in QUANTITIES] == [0.0] * len(QUANTITIES)
    assert own["near_misses"] == own["near_misses_people"] and own["ttc_below_2"] == own["ttc_below_2_people"]
    assert own["wide_kappa"] == 1.0


def test_position_errors_rank_copy_late_and_the_rest(planted: dict[str, dict[str, Any]]) -> None:
    errors = {name: own["position_error_m"] for name, own in planted.items()}
    assert errors["copy"] < errors["late"] < min(errors["never"], errors["superhuman"])


def test_late_driver_reacts_a_second_late(planted: dict[str, dict[str, Any]]) -> None:
    assert planted["late"]["onset_error_s"] == pytest.approx(1.0, abs=0.05)
    assert planted["late"]["strongest_braking_ks"] < 0.2  # as hard as people


def test_who_never_yields_touches_and_never_reacts(planted: dict[str, dict[str, Any]]) -> None:
    own = planted["never"]
    assert own["contacts"] == 30 and own["near_misses"] == 1.0
    assert own["reacted"] == 0.0 and own["onset_s"] is None and own["onset_ks"] == pytest.approx(1.0)
    assert own["wide_kappa"] == pytest.approx(0.0, abs=1e-9)


def test_superhuman_driver_is_a_hero_and_polite(planted: dict[str, dict[str, Any]]) -> None:
    own = planted["superhuman"]
    assert own["heroism"] == 1.0 and own["politeness_m"] > 1.0 and own["contacts"] == 0
    assert own["strongest_braking_mps2"] == pytest.approx(-8.0)


def test_intervals_hold_the_figures_and_kinds_are_told_apart(planted: dict[str, dict[str, Any]]) -> None:
    own = planted["late"]
    assert own["kinds"]["leader_brakes"]["encounters"] == own["encounters"] == 30
    low, high = own["position_error_m_interval"]
    assert low < own["position_error_m"] < high
    assert own["kinds"]["leader_brakes"]["position_error_m_interval"] == [low, high]
    low, high = own["least_gap_ks_interval"]
    assert low < own["least_gap_ks"] < high
