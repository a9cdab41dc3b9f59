"""Settings of the whole suite."""

import sys

import hypothesis
import pytest

# Compiled functions take seconds at their first call; the same examples on every machine and run.
hypothesis.settings.register_profile("suite", deadline=None, derandomize=True)
hypothesis.settings.load_profile("suite")


@pytest.fixture(autouse=True)
def denormals():
    """Training flushes denormal numbers to zero for its whole process: not for the tests after it."""
    yield
    if "torch" in sys.modules:
        sys.modules["torch"].set_flush_denormal(False)
