"""A Ray cluster as an executor of `concurrent.futures`."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

from inclined_landing.envs.shared import runs
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

_PATIENCE = 5.0  # s to wait for a connection
_RETRIES = 3  # of a call whose process or machine was lost


def check(address: str | None, option: str) -> None:
    """Raise UserError unless Ray is installed and, where an address HOST:PORT is given, a cluster answers.

    option: the one that asks for Ray, as sentences name it.
    """
    _prepare(address)
    import_ray(option)
    if address is not None:
        _knock(address)
        with connected(address):
            pass


def _prepare(address: str | None) -> None:
    """Set what Ray reads when it is imported, where it is not set."""
    if address is None:
        wanted = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}  # nothing listens but on the loopback
    else:  # the patience for the first word of a cluster; Ray's own is a quarter of an hour
        wanted = {"RAY_NUM_REDIS_GET_RETRIES": "1", "RAY_py_gcs_connect_timeout_s": "10"}
        # Ray shows its token only to clusters that it finds by itself.
        named = os.environ.keys() & {"RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"}
        if named or Path("~/.ray/auth_token").expanduser().is_file():
            wanted["RAY_AUTH_MODE"] = "token"
    for name, value in wanted.items():
        os.environ.setdefault(name, value)


def import_ray(option: str = "Ray"):
    """Return the package ray; raises UserError where it is not installed."""
    try:
        import ray

        ray.init  # noqa: B018 (a folder named ray, such as Ray's own in /tmp, imports as a package)
    except (ImportError, AttributeError) as error:
        raise UserError(
            f"{option} needs Ray, which is not installed; pip install 'inclined-landing[ray]'"
        ) from error
    logging.getLogger("ray").setLevel(logging.ERROR)
    return ray


class Cluster(Executor):
    """Calls functions on the machines of a Ray cluster, each call on one core.

    A call whose process or machine is lost is made again, on another machine, up to three times: what is
    called has to bear that. What it raises comes back as a subclass of its exception and of Ray's.
    """

    def __init__(self, ray):
        self._ray = ray
        self._remote = ray.remote(num_cpus=1, max_retries=_RETRIES)(_called)
        self._versions = runs.packages()

    def submit(self, function: Callable, /, *arguments: Any) -> Future:  # type: ignore[override]
        """Return the future result of a call; functions and arguments have to be picklable."""
        remote = self._remote.options(name=function.__name__)
        return remote.remote(self._versions, function, *arguments).future()

    def share(self, value: Any) -> Any:
        """Return what stands for `value` among arguments, so that it is sent to a machine once."""
        return self._ray.put(value)


@contextlib.contextmanager
def connected(address: str | None) -> Iterator[Cluster]:
    """Yield the cluster at the address HOST:PORT; without one, Ray is started for this machine alone.

    Raises UserError where it cannot be reached, and for calls that it could not carry out. Calls under way
    end with the context.
    """
    ray = import_ray()
    try:
        with _own_signals():
            _connect(ray, address)
    except (OSError, ValueError, RuntimeError, ImportError) as error:
        where = f"at {shown(address)}" if address else "on this machine"
        hint = "; is this machine one of its nodes, with its token?" if address else ""
        raise UserError(f"Ray cannot be reached {where}: {shown(error, 150)}{hint}") from error
    try:
        yield Cluster(ray)
    except ray.exceptions.RayError as error:
        if isinstance(cause := getattr(error, "cause", None), UserError):
            raise cause from error
        last = (str(error).strip().splitlines() or ["no reason given"])[-1]
        raise UserError(f"Ray gave up: {shown(last, 400)}") from error
    finally:
        ray.shutdown()


def _connect(ray, address: str | None) -> None:
    quiet = {"include_dashboard": False, "log_to_driver": False, "configure_logging": False}
    ray.init(address or "local", **quiet)


@contextlib.contextmanager
def _own_signals() -> Iterator[None]:
    """Keep the answer to SIGTERM, which Ray replaces."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):  # not in the main thread
            signal.signal(signal.SIGTERM, before)


def _called(versions: dict, function: Callable, *arguments: Any) -> Any:
    """Return what a call returns, on a machine of the cluster."""
    for name, own in runs.packages().items():
        if own != versions[name]:
            raise UserError(
                f"{os.uname().nodename} has {name} {own}, and this machine {versions[name]}: the machines of "
                "a cluster need the same packages"
            )
    return function(*arguments)


def _knock(address: str) -> None:
    """Raise UserError unless something listens at the address: Ray itself would try for longer."""
    host, _, port = address.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and len(port) <= 5) or not 0 < int(port) < 65536:
        raise UserError(f"--address must be HOST:PORT, not {shown(repr(address))}")
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
    except (OSError, ValueError) as error:  # ValueError: no name of a host
        raise UserError(f"no Ray cluster answers at {shown(address)}: {storage.reason(error)}") from error
