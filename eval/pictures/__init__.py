"""Pictures of flights and training runs: `figure`, `video`, `picture`, `curves`."""
