"""Settings of the whole suite."""

import sys

import hypothesis
import pytest
from campaign import judge

# Compiled functions take seconds at their first call; the same examples on every machine and run.
hypothesis.settings.register_profile("suite", deadline=None, derandomize=True)
hypothesis.settings.load_profile("suite")


def pytest_configure(config):
    """The campaign leaves its slow cases out where they would only be deselected."""
    judge.whole = config.option.markexpr != "not slow"


@pytest.fixture(autouse=True)
def denormals():
    """Training flushes denormal numbers to zero for its whole process: not for the tests after it."""
    yield
    if "torch" in sys.modules:
        sys.modules["torch"].set_flush_denormal(False)
