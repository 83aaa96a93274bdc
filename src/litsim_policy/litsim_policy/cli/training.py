"""Entry points of the training programs, which need torch; imported on call, so that a lack of it is reported."""

from __future__ import annotations

from litsim_sim.cli.program import program


@program
def train() -> None:
    """Entry point of ``ros2 run litsim_policy train``."""
    from litsim_policy.learning.train import main

    main()


@program
def train_imitation() -> None:
    """Entry point of ``ros2 run litsim_policy train_imitation``."""
    from litsim_policy.learning.imitation.train import main

    main()


@program
def train_simnet() -> None:
    """Entry point of ``ros2 run litsim_policy train_simnet``."""
    from litsim_policy.learning.simnet_train import main

    main()
