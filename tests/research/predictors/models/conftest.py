"""Two small scenes, for tests of all models."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from litsim_research.predictors.data.augmentation import Augmentation
from litsim_research.predictors.data.batch import SceneBatch
from litsim_research.predictors.data.scenes import training_batches
from litsim_research.predictors.data.tracks import Tracks
from litsim_sim.scenario.scenario import packaged


@pytest.fixture
def batch(straight: Callable[..., pd.DataFrame]) -> SceneBatch:
    """Two scenes of four and two agents on the net us101_like."""
    four = straight((1, 150.0, -5.5, 10.0), (2, 165.0, -5.4, 8.0), (3, 150.0, -9.2, 12.0), (4, 190.0, -9.0, 0.0))
    two = straight((7, 300.0, -1.8, 14.0), (9, 320.0, -1.8, 13.0))
    two["frame"] += 1000
    tracks = Tracks.from_table("made", pd.concat([four, two]), packaged("nets/us101_like.net.xml"))
    return next(training_batches([(tracks, 1.0)], 99, 45, Augmentation(crop=0), np.random.default_rng(3)))
