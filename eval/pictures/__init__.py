"""What a flight or a training looks like: `figure`, `video`, `picture`, `curves`."""
