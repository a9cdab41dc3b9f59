"""PPO with a compiled forward pass and a fused update, behind Stable-Baselines3's interface."""
