"""What generated traffic is used for, by the seeds of :func:`.segment_set.write_segment_set`: nothing twice.

What is reported on is seen by no training, no calibration and no choice. A test reads the manifests of all weights that
come with LitSim and says whether it is so.
"""

from __future__ import annotations

TRAINING = frozenset({4000, 4100})
"""Policies are trained on these."""

CALIBRATION = frozenset({5000})
"""Thresholds and other parameters are chosen on these, beside the tuning egos of scenarios."""

PAPER = (77000, 77001, 77002, 77003, 77004)
"""Draws of generated traffic of the paper's experiments."""

LEFT_TURNS = 78000
"""Street in which the left turn of the paper's case studies is looked for."""

REPORTED = frozenset({9000, *PAPER, LEFT_TURNS})
"""Results are reported on these, and nothing else is done with them."""

DEMO_RECORDING = "us101_like"
"""Name of the recording of scenario demo, which the shipped predictors were trained on.

What is reported on the demo with one of them is no test of it.
"""
