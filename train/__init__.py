"""PPO configuration, curriculum, callbacks and the `landing-train` command."""
