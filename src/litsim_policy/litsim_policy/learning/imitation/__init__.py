"""Training of the baselines `gail` and `rail`: networks that imitate traffic, by a critic and PPO."""
