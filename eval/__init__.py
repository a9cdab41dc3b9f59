"""Evaluation: the commands of `landing-eval`, in modules of `cli.GROUPS`, and the report of a training."""
