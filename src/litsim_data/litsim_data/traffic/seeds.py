"""Uses of generated traffic, by the seeds of :func:`.segment_set.write_segment_set`; the uses are disjoint.

Results are reported on traffic that no training, calibration or choice of parameters has seen: its seeds are drawn by
`tools/draw_seeds.py` once the code is frozen. A test checks the manifests of all packaged weights.
"""

from __future__ import annotations

import json
from importlib import resources

TRAINING = frozenset({4000, 4100})
"""Policies are trained on these."""

CALIBRATION = frozenset({5000, 8302})
"""Thresholds, rules and other parameters are chosen on these, beside the tuning egos of scenarios."""

DEMO = 9119
"""Recording of scenario demo, the first from 9100 on in which exactly ten vehicles stay from first frame to last."""

_drawn = json.loads(resources.files("litsim_data").joinpath("traffic/reported.json").read_text(encoding="utf-8"))

PAPER: tuple[int, ...] = tuple(_drawn["paper"])
"""Draws of generated traffic of the paper's experiments."""

LEFT_TURNS: int = _drawn["left_turns"]
"""Street that is searched for the left turn of the paper's case studies."""

FREEWAYS: int = _drawn["freeways"]
"""Freeways of docs/results.md beside the paper's experiments."""

REPORTED = frozenset({DEMO, *PAPER, LEFT_TURNS, FREEWAYS})
"""Results are reported on these, which are used for nothing else."""
