"""Entry points of the training programs, which need torch; imported on call, so that a lack of it is reported."""

from __future__ import annotations

from litsim_sim.cli.program import program


@program
def train() -> None:
    """Entry point of ``ros2 run litsim_research train policy``."""
    from litsim_research.policies.train import main

    main()


@program
def train_imitation() -> None:
    """Entry point of ``ros2 run litsim_research train imitation``."""
    from litsim_research.imitation.train import main

    main()


@program
def train_simnet() -> None:
    """Entry point of ``ros2 run litsim_research train simnet``."""
    from litsim_research.policies.simnet_train import main

    main()
