"""Training of policy C: environment, reward, critic, PPO."""
