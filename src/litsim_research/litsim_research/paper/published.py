"""Figures reported in the paper: 28 s segments of complete NGSIM files, ego BAT, averages of five runs."""

from __future__ import annotations

from collections.abc import Mapping

OTHER_DATA = "paper, other data"

TABLE: Mapping[str, Mapping[str, float]] = {
    "IDM": {
        "ade_5": 0.25, "ade_10": 1.13, "ade_15": 2.56, "ade_20": 4.67, "ade_25": 8.26,
        "collision": 0.0868, "reactivity": 0.4625, "progress": 192.25, "relevant": 0.1730,
    },
    "GAIL": {
        "ade_5": 0.61, "ade_10": 2.78, "ade_15": 6.42, "ade_20": 12.36, "ade_25": 24.43,
        "collision": 0.0676, "reactivity": 0.6129, "progress": 201.38, "relevant": 0.1716,
    },
    "SimNet": {
        "ade_5": 0.52, "ade_10": 2.12, "ade_15": 5.74, "ade_20": 10.02, "ade_25": 18.68,
        "collision": 0.0528, "reactivity": 0.8035, "progress": 197.50, "relevant": 0.1420,
    },
    "LitSim": {
        "ade_5": 0.48, "ade_10": 1.37, "ade_15": 2.75, "ade_20": 4.60, "ade_25": 7.73,
        "collision": 0.0353, "reactivity": 0.9136, "progress": 195.03, "relevant": 0.0240,
    },
}  # fmt: skip
"""Table II, by method and by the key of the measure; shares between 0 and 1."""

ABLATION: Mapping[str, Mapping[str, float]] = {
    "M0": {"ade_25": 46.88, "collision": 0.1029, "progress": 196.51, "relevant": 0.0279},
    "M1": {"ade_25": 9.62, "collision": 0.0373, "progress": 194.79, "relevant": 0.0185},
    "M2": {"ade_25": 8.63, "collision": 0.0366, "progress": 195.87, "relevant": 0.0174},
    "M*": {"ade_25": 7.73, "collision": 0.0353, "progress": 195.03, "relevant": 0.0240},
}
"""The ablation study, likewise."""
