"""Uses of generated traffic, by the seeds of :func:`.segment_set.write_segment_set`; the uses are disjoint.

Results are reported on traffic that no training, calibration or choice of parameters has seen. A test checks this in
the manifests of all packaged weights.
"""

from __future__ import annotations

TRAINING = frozenset({4000, 4100})
"""Policies are trained on these."""

CALIBRATION = frozenset({5000})
"""Thresholds and other parameters are chosen on these, beside the tuning egos of scenarios."""

PAPER = (77000, 77001, 77002, 77003, 77004)
"""Draws of generated traffic of the paper's experiments."""

LEFT_TURNS = 78000
"""Street that is searched for the left turn of the paper's case studies."""

DEMO = 9119
"""Recording of scenario demo, the first from 9100 on in which exactly ten vehicles stay from first frame to last."""

REPORTED = frozenset({9000, DEMO, *PAPER, LEFT_TURNS})
"""Results are reported on these, which are used for nothing else."""
