"""The configuration of a joint predictor, which its model of torch and its kernels share."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from litsim_predictor.inference.contract import HISTORY_CHANNELS, LayerWidth
from litsim_sim.core.quantities import Flag, Length, Share, Whole, configuration

Kind = Literal["direct", "recurrent"]
"""Whether steps are read all at once, or one after the other as in the paper."""


@configuration
class JointParameters:
    """Field `parameters` of a training configuration, and of a file of weights, whose model is `joint`.

    Attributes:
        map_width, map_channels: width and channels of the map encoder.
        history_width: width of the history encoder; of a recurrent one, both directions together.
        history: how histories are read; "recurrent" is the paper's choice.
        history_channels: channels that a recurrent encoder reads: 2 for coordinates (paper), 4 with yaw and speed.
        state_width: width of the encoder of current states.
        traffic: whether states include the speed of the traffic ahead; see :mod:`.traffic`. Needs attention to codes.
        heads: number of heads of the attention.
        attention: what an agent attends to: "codes" of the others and how they lie and move relative to it, `layers`
            times; or, as in the paper, their "states" alone, relative to it.
        layers: number of layers of attention to codes.
        neighbours: greatest number of nearest agents that an agent attends to, so that the cost of attention grows with
            the number of agents only.
        reach: distance within which these must be.
        decoder: how futures are decoded; "recurrent" is the paper's choice.
        hidden: width of the decoder.
        dropout: probability with which a value is hidden from the decoder in training.
    """

    map_width: LayerWidth = 64
    map_channels: LayerWidth = 16
    history_width: LayerWidth = 64
    history: Kind = "recurrent"
    history_channels: Annotated[Whole, Field(ge=1, le=HISTORY_CHANNELS)] = HISTORY_CHANNELS
    state_width: LayerWidth = 32
    traffic: Flag = False
    heads: LayerWidth = 8
    attention: Literal["codes", "states"] = "codes"
    layers: Annotated[Whole, Field(gt=0, le=8)] = 2
    neighbours: Annotated[Whole, Field(ge=0, le=10**12)] = 12
    reach: Annotated[Length, Field(gt=0, le=10_000)] = 80.0
    decoder: Kind = "direct"
    hidden: LayerWidth = 128
    dropout: Share = 0.1

    @model_validator(mode="after")
    def _fit(self) -> Self:
        attended = self.width if self.attention == "codes" else self.state_width
        if attended % self.heads:
            raise ValueError(f"heads is {self.heads}, expected a divisor of {attended}, the width of the attention")
        for name, kind in (("history_width", self.history), ("hidden", self.decoder)):
            if kind != "direct" and getattr(self, name) % 2:
                raise ValueError(f"{name} is {getattr(self, name)}, expected an even number: two directions share it")
        if self.traffic and self.attention == "states":
            raise ValueError("traffic is True, expected False where attention is states")
        return self

    @property
    def width(self) -> int:
        """Width of the code of an agent."""
        return self.map_width + self.history_width + self.state_width
