"""Settings of the whole suite."""

# ruff: noqa: E402

import os
import re
import sys
from pathlib import Path

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


def pytest_configure():
    """Remove compiled functions that are older than a source of what may be compiled into them.

    Numba looks at a function's own file only. Imports only go down, so that those of models use no others.
    """
    if "PYTEST_XDIST_WORKER" in os.environ or "NUMBA_CACHE_DIR" in os.environ:
        return
    root, newest = Path(__file__).parents[1], {}
    for folder in ("models", "envs", "train", "eval"):
        texts = {path: path.read_text("utf-8") for path in (root / folder).rglob("*.py")}
        sources = (path for path, text in texts.items() if re.search("compiled import|import numba", text))
        newest[folder] = max((path.stat().st_mtime for path in sources), default=0.0)
        used = max(newest[name] for name in {"models", "envs", folder} & set(newest))
        for index in (root / folder).rglob("__pycache__/*.nbi"):
            if index.stat().st_mtime < used:
                index.unlink(missing_ok=True)


@pytest.fixture(autouse=True)
def denormals():
    """Training flushes denormal numbers to zero for its whole process: not for the tests after it."""
    yield
    if "torch" in sys.modules:
        sys.modules["torch"].set_flush_denormal(False)
