"""Evaluation: each subpackage contains commands of `landing-eval`, in modules of the same names."""
