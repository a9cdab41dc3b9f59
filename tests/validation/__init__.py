"""Scripts that make evidence, run as `python -m tests.validation.NAME` from the root of the repository."""
