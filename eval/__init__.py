"""Evaluation: each subpackage holds commands of `landing-eval`, in modules of the same names."""
