"""Evaluation: the commands of `landing-eval`, in the modules that `cli.GROUPS` lists, and what they share.

`after_training` is the report of `landing-train`.
"""
