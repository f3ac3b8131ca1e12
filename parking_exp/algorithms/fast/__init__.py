"""SAC, TD3 and DDPG of Stable-Baselines3 with a faster update: the same arithmetic in less time."""
