"""Check of the torch device that a user has chosen for models."""

from __future__ import annotations

import torch

from litsim_sim.core.errors import InputError


def check_device(name: str) -> None:
    """Check that torch has the device `name` on this machine.

    Raises:
        InputError: there is no such device here.
    """
    try:
        torch.empty(0, device=name)
    except (RuntimeError, AssertionError) as error:  # a build without CUDA asserts
        raise InputError(f"--device {name}: {str(error).splitlines()[0]}; expected one of torch, as cpu") from error
