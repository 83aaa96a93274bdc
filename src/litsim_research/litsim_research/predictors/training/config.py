"""The configuration of a training of a learned predictor, and the data that it takes unless it says otherwise."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from litsim_research.predictors.data.augmentation import Augmentation
from litsim_research.predictors.data.sources import (
    I80LaneSource,
    RecordingSource,
    Source,
    Us101TrackSource,
    Us101WindowSource,
)
from litsim_sim.scenario.scenario_file import SEEDS

WINDOWS, TRACKS = "ngsim/us101_0750_frames_0126_1149.parquet", "ngsim/us101_vehicle_tracks.parquet"
TEST_FRAMES = (316, 543)
"""First and last frame of the US-101 window on which results are reported: scenario us101_0750."""
DEVELOPMENT_DATA: tuple[Source, ...] = (
    Us101TrackSource(kind="us101_tracks", file=TRACKS, windows=WINDOWS, test_frames=TEST_FRAMES),
    # Few, but the only real scenes in which every vehicle is seen.
    Us101WindowSource(kind="us101_windows", file=WINDOWS, test_frames=TEST_FRAMES, share=4.0),
    I80LaneSource(kind="i80_lanes", file="ngsim/i80_lanes_1_7_longitudinal.parquet", share=0.25),
    RecordingSource(kind="recording", files=("us101_like.parquet",), share=0.5),  # packaged; not that of scenario demo
)


class TrainingConfig(BaseModel):
    """A training configuration file.

    Attributes:
        model, parameters: see :func:`.registry.build`.
        start: file of initial weights of the same model, such as from a training on other data, found like the files of
            `data`; empty for random initial weights.
        teachers: trained models of any kind, as names of shipped weights or files found like `start`; the model also
            learns the mean of their forecasts (distillation).
        teacher_weight: weight [1/m2] of the distillation loss: the squared distance from that mean, for agents trained
            with their most probable manoeuvre (see `predicted_share`).
        data: sources; names of files are looked for beside the configuration and under LITSIM_DATA.
        fraction: share of the target vehicles of each source that are trained on; see :meth:`.Tracks.learned_of`. The
            frames that are left are repeated, so that an epoch has about as many optimiser steps as with all vehicles.
        epochs: number of epochs. In the first `warm_epochs`, the squared error replaces the likelihood in the loss.
        agents_per_batch: approximate number of agents in a batch of whole scenes.
        stride: frames between the scenes of an epoch.
        learning_rate: initial learning rate of AdamW; it follows a cosine towards zero over all epochs.
        divided_every: epochs after which the learning rate is divided by 10 instead, again and again, as in the paper;
            0 for the cosine.
        weight_decay: of AdamW; 0 is Adam.
        averaging: decay rate, per optimiser step, of the exponential moving average (EMA) of the weights, which is
            validated and saved; 0 for the weights themselves.
        error_weight, maneuver_weight: weights of the squared error [1/m2] and of the cross-entropy of manoeuvres in the
            loss, beside the likelihood.
        predicted_share: share of the agents of a batch that are trained with the most probable manoeuvre, with which
            forecasts are used and scored, instead of the true one, which teaches the decoder what manoeuvres mean.
        forcing_epochs: epochs over which teacher forcing fades from all batches to none; 0 for no teacher forcing.
            Decoders that read no positions ignore it.
        augmentation: random variation of scenes.
        seed: determines everything except rounding.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    model: str
    parameters: dict[str, Any] = {}
    start: str = ""
    teachers: tuple[str, ...] = ()
    teacher_weight: Annotated[float, Field(ge=0)] = 0.5
    data: tuple[Source, ...] = DEVELOPMENT_DATA
    fraction: Annotated[float, Field(gt=0, le=1)] = 1.0
    epochs: Annotated[int, Field(ge=1, le=100_000)] = 20
    warm_epochs: Annotated[int, Field(ge=0)] = 2
    agents_per_batch: Annotated[int, Field(ge=1)] = 512
    stride: Annotated[int, Field(ge=1, le=36_000)] = 5
    learning_rate: Annotated[float, Field(gt=0, le=1e30)] = 1e-3
    divided_every: Annotated[int, Field(ge=0)] = 0
    weight_decay: Annotated[float, Field(ge=0)] = 0.0
    averaging: Annotated[float, Field(ge=0, lt=1)] = 0.0
    error_weight: Annotated[float, Field(ge=0)] = 0.0
    maneuver_weight: Annotated[float, Field(ge=0)] = 1.0
    predicted_share: Annotated[float, Field(ge=0, le=1)] = 0.0
    forcing_epochs: Annotated[int, Field(ge=0)] = 0
    augmentation: Augmentation = Augmentation()
    seed: Annotated[int, Field(ge=0, lt=SEEDS)] = 0
