"""The tests, and what else is run beside the package from a clone of the repository."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
