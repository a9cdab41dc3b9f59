"""The tests, and what else is run beside the package from a clone of the repository."""
