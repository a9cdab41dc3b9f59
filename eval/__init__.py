"""Evaluation, in rooms: each holds the commands of `landing-eval` that it is named for."""
