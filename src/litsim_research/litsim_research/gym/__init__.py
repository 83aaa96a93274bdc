"""Environments of the closed loop: drive a vehicle of the background, many, all that are off their logs, or the ego.

Gymnasium looks up no entry points since version 1.0. Importing this module registers the environments, and so do their
full names: ``gymnasium.make("litsim_research.gym:litsim/Takeover-v0")``.
"""

import gymnasium

gymnasium.register(
    "litsim/Takeover-v0",
    "litsim_research.gym.takeover:TakeoverEnvironment",
    vector_entry_point="litsim_research.gym.vector:TakeoverVectorEnvironment",
)
gymnasium.register("litsim/Ego-v0", "litsim_research.gym.ego:EgoEnvironment")
