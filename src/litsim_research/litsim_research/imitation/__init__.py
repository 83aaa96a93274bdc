"""Training of the baselines `gail` and `rail`: imitation of recorded traffic, with a critic and PPO."""
