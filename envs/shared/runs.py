"""Run folders, and the record of versions for a result."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError

_PACKAGES = (
    *("mujoco", "gymnasium", "stable-baselines3", "torch", "numpy", "numba"),
    "inclined-landing",
)
REPORTED = "success"  # entry of metrics.json that the report on a training run adds
_owned: dict[Path, bool] = {}  # run folders that this process has locked, and whether it made them


def dated(name: str) -> Path:
    """Return the run folder `runs/<name>-<date>-<time>`."""
    return Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"


def check_new_run(path: str | Path) -> None:
    """Raise UserError if `path` cannot become a new run folder; leaves nothing behind."""
    path = storage.as_path(path, "run folder")
    try:
        if path.exists() and not path.is_dir():
            raise UserError(f"the run folder {path} exists and is not a folder; choose another name")
        if path.is_dir() and not all(storage.is_part(p) for p in path.iterdir()):
            raise UserError(f"the run folder {path} exists and is not empty; choose another name")
    except OSError as error:
        raise UserError(f"the run folder {path} cannot be used: {storage.reason(error)}") from error
    storage.check_folder(path)


@contextlib.contextmanager
def owned(path: str | Path, resumable: str | None = None) -> Iterator[bool]:
    """Make the run folder `path` and keep other processes from using it; yields whether it is new.

    resumable: a file name; an existing folder with this file is used with its content. Raises UserError as
    `check_new_run` does, and when another process owns the folder. A new folder that stays empty is removed.
    A process that owns a folder may request it again.
    """
    path = storage.as_path(path, "run folder")
    if (key := storage.real(path)) in _owned:
        yield _owned[key]
        return
    if resumable is None or not (path / resumable).exists():
        check_new_run(path)
        resumable = None
    fresh = not path.is_dir()
    with storage.made(path), locked(path):
        if resumable is None:
            check_new_run(path)  # again: until it was locked, others could write there
            storage.remove_parts(path)
        _owned[key] = fresh
        try:
            yield fresh
            if fresh:
                with contextlib.suppress(OSError):  # it is not empty
                    path.rmdir()
        finally:
            del _owned[key]


@contextlib.contextmanager
def locked(folder: Path, log: Path | None = None, patience: float = 0.0) -> Iterator[int]:
    """Lock the run folder for this process, and for processes that inherit the yielded descriptor.

    log: the file that is opened for appending and locked, because the lock of a folder does not apply to
    other machines that share it. patience: how long [s] to wait for another process. Raises UserError if it
    still uses the folder.
    """
    try:
        handle = (
            os.open(folder, os.O_RDONLY)
            if log is None
            else os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        )
    except OSError as error:
        raise UserError(f"cannot use the run folder {folder}: {storage.reason(error)}") from error
    until = time.monotonic() + patience
    try:
        while not storage.lock(handle):
            if time.monotonic() >= until:
                raise UserError(f"another process is using the run folder {folder}; wait until it ends")
            time.sleep(0.2)
        yield handle
    finally:
        os.close(handle)


@contextlib.contextmanager
def staged_run(path: str | Path) -> Iterator[Path]:
    """Yield a folder for the files of a run; when everything is written, it becomes `path`.

    An existing empty folder, which may be a mount or the current folder of the shell, is kept and receives
    the files. After any error, including an interruption, nothing of the run remains. Raises UserError as
    `owned` does, and when the disk is full.
    """
    with owned(path) as fresh:
        path = Path(path)
        with storage.scratch(path, path.parent if fresh else path) as part:
            try:
                yield part
            except UserError as error:
                raise UserError(str(error).replace(str(part), str(path))) from error
            if fresh:
                os.replace(part, path)
            else:
                for item in sorted(part.iterdir()):
                    os.replace(item, path / item.name)


def versions() -> dict[str, str | int | None]:
    """Return versions, source revision and machine, for the record of a run; imports nothing heavy."""
    result: dict[str, str | int | None] = {"python": platform.python_version(), **packages()}
    result["git revision"] = git_revision()
    result["system"] = platform.platform()
    result["cpu"] = cpu_name()
    result["cores"] = len(os.sched_getaffinity(0))
    return result


def packages() -> dict[str, str | None]:
    """Return versions of the packages that a result depends on; None for one that is not installed."""
    result: dict[str, str | None] = {}
    for package in _PACKAGES:
        try:
            result[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            result[package] = None
    return result


def git_revision() -> str | None:
    """Return the commit of the sources, with `+changes` when files differ; None outside a clone."""
    from inclined_landing import models

    describe = ("git", "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+changes")
    asked: dict[str, Any] = {"capture_output": True, "text": True, "timeout": 10, "check": True}
    for root in (Path(folder).resolve().parent for folder in models.__path__):
        if (root / ".git").exists() and (root / "pyproject.toml").exists():
            with contextlib.suppress(OSError, subprocess.SubprocessError):
                return subprocess.run(describe, cwd=root, **asked).stdout.strip()
    return None


def cpu_name() -> str:
    """Return the name of the processor, if the system provides it."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
