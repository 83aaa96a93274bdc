"""Polylines for properties of paths."""

import numpy as np
from hypothesis import strategies as st


@st.composite
def polylines(draw: st.DrawFn) -> list[np.ndarray]:
    """One to five polylines of 2 to 60 points around the origin, some straight, some that cross themselves."""
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    bend = draw(st.sampled_from([0.0, 0.05, 0.5, 2.0]))
    lines = []
    for count in draw(st.lists(st.integers(2, 60), min_size=1, max_size=5)):
        heading = np.cumsum(random.normal(0.0, bend, count - 1))
        steps = random.uniform(0.3, 3.0, (count - 1, 1)) * np.column_stack([np.cos(heading), np.sin(heading)])
        lines.append(np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]) + random.normal(0.0, 20.0, 2))
    return lines
