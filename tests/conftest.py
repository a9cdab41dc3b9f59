"""Settings of the whole suite."""

# ruff: noqa: E402

import os
import sys

# Every worker of the suite, and every process that a test starts, has one core: thread pools of the linear
# algebra would only wait for each other. Before NumPy is imported.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
# What a shell may say about its screen, and what a developer may have set for Python, is not for the tests.
for _name in ("COLUMNS", "LINES", "FORCE_COLOR", "NO_COLOR", "PYTHONUNBUFFERED", "PYTHONDONTWRITEBYTECODE"):
    os.environ.pop(_name, None)

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
