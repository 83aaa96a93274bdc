"""The whole calibration: car-following on held-in drivers, judged on held-out ones, then lane changes. Seeded.

Its output (``data calibrate --out``) is the input of generated traffic: the packaged ``calibration.json``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from litsim_data.traffic.calibration import IDM, KRAUSS, Model, Pairs, fit_common, fit_each, gap_rmse
from litsim_data.traffic.calibration_data import I80_PAIRS, US101_TRACKS, US101_WINDOWS, car_following
from litsim_data.traffic.comparison import generated, recorded
from litsim_data.traffic.drivers import Behaviour
from litsim_data.traffic.sites import US101_LIKE
from litsim_data.traffic.synthetic import synthesize_all
from litsim_sim.core.scene import FloatArray

HELD_IN = 0.7  # share of the drivers that are calibrated; the others judge
OWN_PART = 0.6  # share of a held-out pair that its own parameters may see
PUBLISHED = {  # common values from elsewhere, to compare with
    "IDM": ("published (ngsim_env)", (20.0, 0.5, 2.0, 3.0, 2.5)),
    "Krauss": ("SUMO's defaults", (29.0, 1.0, 2.5, 2.6, 4.5)),
}
QUANTILES = (10, 25, 50, 75, 90)
SPEED_GAINS = (1.0, 2.0, 4.0, 8.0)  # between which the one with the recorded rate of lane changes is looked for
LANE_CHANGE_SEEDS, LANE_CHANGE_SECONDS = (11, 12, 13, 14, 15, 16), 140.5
DECIMALS = 3


@dataclass(frozen=True)
class Fit:
    """One model on all pairs.

    Attributes:
        model: which.
        sites: (n,) site of every held-in pair.
        common: (5,) one set for all of them.
        each: (n, 5) their own sets.
        errors: (n,) gap errors with their own sets [m].
        judged: gap errors [m] of held-out pairs (m,) by what predicted them.
    """

    model: Model
    sites: np.ndarray
    common: FloatArray
    each: FloatArray
    errors: FloatArray
    judged: dict[str, FloatArray]


def calibrate(data: Path, seed: int, say: Callable[[str], None]) -> dict[str, Any]:
    """Run the calibration on the data in folder `data`; `say` is called with lines on the progress and the report.

    Returns:
        The content of the parameter file.

    Raises:
        InputError: data is missing.
    """
    pairs = car_following(data)
    held_in = split_by_driver(pairs, seed)
    train, test = pairs.take(held_in), pairs.take(~held_in)
    say(f"{len(pairs)} stretches of car-following: {len(train)} calibrate, {len(test)} of other drivers judge")
    fits = [fit(model, train, test, seed) for model in (IDM, KRAUSS)]
    for line in table(fits):
        say(line)
    best = fits[0]
    drivers = {str(site): np.round(best.each[best.sites == site], DECIMALS) for site in np.unique(best.sites)}
    real = recorded(data)
    gain, tried = _speed_gain(drivers, real.rate)
    for tried_gain, rate in tried:
        say(f"lcSpeedGain {tried_gain:g}: {rate:.2f} lane changes per km")
    say(f"lcSpeedGain {gain:.2f} for the recorded {real.rate:.2f} per km ({real.changes} in {real.kilometres:.1f} km)")
    return {
        "provenance": {
            "by": "data calibrate",
            "seed": seed,
            "data": [I80_PAIRS, US101_TRACKS, US101_WINDOWS],
            "source": "NGSIM, US DOT / FHWA, doi 10.21949/1504477; only values derived from it are here",
            "method": "least root mean square error of the gap behind the recorded leader, differential evolution",
            "units": "v0 m/s, T s, s0 m, a_max m/s2, b m/s2, gap errors m",
        },
        "car_following": {fitted.model.name: _summary(fitted) for fitted in fits},
        "lane_change": {
            "lcSpeedGain": round(gain, DECIMALS),
            "recorded_per_km": round(real.rate, DECIMALS),
            "tried": [[value, round(rate, DECIMALS)] for value, rate in tried],
        },
        "drivers": {site: rows.tolist() for site, rows in drivers.items()},
    }


def write(values: dict[str, Any], path: Path) -> None:
    """Write the parameter file: JSON, one driver a line."""
    drivers = values["drivers"]
    head = json.dumps({key: value for key, value in values.items() if key != "drivers"}, indent=1)
    lines = {site: ",\n".join(f"  {json.dumps(row)}" for row in rows) for site, rows in drivers.items()}
    lists = ",\n".join(f' "{site}": [\n{rows}\n ]' for site, rows in lines.items())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(head[: head.rindex("}")].rstrip() + ',\n "drivers": {\n' + lists + "\n }\n}\n", encoding="utf-8")


def split_by_driver(pairs: Pairs, seed: int) -> np.ndarray:
    """Mask (n,) of the pairs to calibrate with: all pairs of a random share HELD_IN of the drivers."""
    drivers = np.unique(pairs.follower)
    chosen = np.random.default_rng(seed).permutation(drivers)[: round(HELD_IN * len(drivers))]
    return np.isin(pairs.follower, chosen)


def fit(model: Model, train: Pairs, test: Pairs, seed: int) -> Fit:
    """Calibrate `model` on `train` and judge it on `test`."""
    common = fit_common(model, train, seed)
    each = fit_each(model, train, common, seed)
    own = fit_each(model, test.part(0.0, OWN_PART), common, seed)
    name, published = PUBLISHED[model.name]
    later = test.part(OWN_PART, 1.0)

    def shared(values: FloatArray, pairs: Pairs) -> FloatArray:
        return gap_rmse(model, np.broadcast_to(values, (len(pairs), len(values))), pairs)

    judged = {
        "common set": shared(common, test),
        "medians": shared(np.median(each, axis=0), test),
        name: shared(np.array(published), test),
        f"last {1 - OWN_PART:.0%}: own set of the first {OWN_PART:.0%}": gap_rmse(model, own, later),
        f"last {1 - OWN_PART:.0%}: common set": shared(common, later),
    }
    return Fit(model, train.name, common, each, gap_rmse(model, each, train), judged)


def table(fits: list[Fit]) -> Iterator[str]:
    """The report, line by line: parameters on held-in drivers, errors on held-out ones."""
    for fitted in fits:
        model = fitted.model
        yield f"{model.name}: median [25 % to 75 %] of held-in pairs; share of fits at a bound of the search"
        for site in np.unique(fitted.sites):
            rows = fitted.sites == site
            values, errors = fitted.each[rows], np.median(fitted.errors[rows])
            at_bound = ((values <= 1.01 * model.low) | (values >= 0.99 * model.high)).mean(axis=0)
            low, middle, high = np.percentile(values, (25, 50, 75), axis=0)
            cells = [
                f"{name} {m:.2f} [{a:.2f} to {b:.2f}] {share:.0%}"
                for name, a, m, b, share in zip(model.parameters, low, middle, high, at_bound, strict=True)
            ]
            yield f"  {site:<7} n={rows.sum():<4} gap RMSE {errors:.2f} m  " + "  ".join(cells)
        cells = [f"{name} {value:.2f}" for name, value in zip(model.parameters, fitted.common, strict=True)]
        yield f"  common set: {', '.join(cells)}"
        yield "  gap RMSE of held-out drivers [m]: mean (median)"
        for name, errors in fitted.judged.items():
            yield f"    {name:<38}{errors.mean():>6.2f} ({np.median(errors):.2f})"


def _speed_gain(drivers: dict[str, FloatArray], rate: float) -> tuple[float, list[tuple[float, float]]]:
    """The lcSpeedGain that gives `rate` lane changes per km on us101_like, and what was tried: gains and rates."""
    tried = []
    for gain in SPEED_GAINS:
        behaviour = Behaviour("trial", drivers, gain)
        made = synthesize_all(US101_LIKE, list(LANE_CHANGE_SEEDS), LANE_CHANGE_SECONDS, behaviour)
        tried.append((gain, generated(made).rate))
    rates = np.maximum.accumulate([found for _, found in tried])
    return float(np.exp(np.interp(rate, rates, np.log(SPEED_GAINS)))), tried


def _summary(fitted: Fit) -> dict[str, Any]:
    names = fitted.model.parameters

    def rows(values: FloatArray) -> dict[str, Any]:
        found = np.percentile(values, QUANTILES, axis=0)
        return {name: np.round(found[:, at], DECIMALS).tolist() for at, name in enumerate(names)}

    sites = {
        str(site): {
            "pairs": int((fitted.sites == site).sum()),
            "percentiles": list(QUANTILES),
            **rows(fitted.each[fitted.sites == site]),
            "gap_rmse_median": round(float(np.median(fitted.errors[fitted.sites == site])), DECIMALS),
        }
        for site in np.unique(fitted.sites)
    }
    common = dict(zip(names, np.round(fitted.common, DECIMALS).tolist(), strict=True))
    judged = {name: round(float(errors.mean()), DECIMALS) for name, errors in fitted.judged.items()}
    return {"common": common, "held_in": sites, "held_out_gap_rmse_mean": judged}
