"""A training that diverges ends with a message, instead of going on with a network that answers nothing finite."""

from __future__ import annotations

from torch import nn

from litsim_sim.core.errors import InputError

WEIGHT_MAX = 1e6  # far above the weights of any network here that has learned something


def refuse_divergence(network: nn.Module, field: str, learning_rate: float) -> None:
    """Check the weights of `network`, after steps of an optimiser with `learning_rate`.

    Raises:
        InputError: a weight exceeds WEIGHT_MAX or is undefined; the message names `field`, in which the configuration
            gives the learning rate.
    """
    if not all(bool((weights.abs() <= WEIGHT_MAX).all()) for weights in network.parameters()):
        raise InputError(
            f"training configuration: field {field} is {learning_rate:g}, with which weights exceed {WEIGHT_MAX:g}; "
            "expected a smaller one"
        )
