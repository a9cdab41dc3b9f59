"""Parallel calls, in threads of this process, in a fork of it, or as tasks of a Ray cluster."""

from __future__ import annotations

import contextlib
import functools
import logging
import multiprocessing
import os
import signal
import socket
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, TypeVar

from inclined_landing.envs.shared import runs
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown

PLACES = ("local", "ray")
Item = TypeVar("Item")
_PATIENCE = 5.0  # s to wait for a connection
_RETRIES = 3  # of a call whose process or machine was lost


def check(on: str, address: str | None, option: str) -> None:
    """Raise UserError for a place that is unknown, not installed or unreachable.

    on: one of PLACES. address: HOST:PORT of a running Ray cluster. option: the option that selects the place.
    """
    if on not in PLACES:
        raise UserError(f"{option} must be {' or '.join(PLACES)}, not {shown(repr(on), 40)}")
    if on == "local":
        if address is not None:
            raise UserError(f"--address needs {option} ray")
        return
    _prepare(address)
    import_ray(f"{option} ray")
    if address is not None:
        _knock(address)
        with _connected(address):
            pass


def completed(
    function: Callable,
    shared: Sequence[Any],
    items: Iterable[Item],
    on: str = "local",
    address: str | None = None,
    at_once: int = 1,
) -> Generator[tuple[Item, Any]]:
    """Yield every item with what `function(*shared, item)` returns, as the calls finish.

    at_once: number of parallel calls on this machine. On Ray everything has to be picklable, `shared` is sent
    to a machine once, each call takes one core, and a call whose process or machine is lost is repeated on
    another, which must be harmless.
    """
    threads = contextlib.nullcontext(ThreadPoolExecutor(at_once))
    with threads if on == "local" else _connected(address) as pool:
        try:
            if isinstance(pool, _Cluster):
                shared = [pool.ray.put(value) for value in shared]
            pending = {pool.submit(function, *shared, item): item for item in items}
            for future in as_completed(pending):
                yield pending.pop(future), future.result()
        finally:  # without waiting for what is under way
            pool.shutdown(wait=False, cancel_futures=True)


def in_fork(function: Callable[..., Item], *arguments: Any, ticks: bool = False) -> Callable[..., Item]:
    """Begin a call in a forked process, and return a function that waits for its result.

    For work in Python, which takes turns with other threads of its process. Only what the call returns or
    raises has to be picklable. The process ends with this one. ticks: the call gets an option `tick`, and the
    words it gives to that are given to the tick that the returned function is called with.
    """
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe(duplex=False)

    def send(kind: str, value: Any) -> None:
        with contextlib.suppress(BrokenPipeError):  # of a process that has ended, and waits no more
            there.send((kind, value))

    def answer() -> None:
        here.close()  # otherwise no pipe would break
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # by which a process at its end ends this one
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        options = {"tick": functools.partial(send, "tick")} if ticks else {}
        try:
            send("result", function(*arguments, **options))
        except BaseException as error:
            send("error", error)

    process = fork.Process(target=answer, daemon=True)
    # Until the new process has its own handlers, signals to it wait.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    there.close()

    def result(tick: Callable[[str], None] = lambda words: None) -> Item:
        try:
            while (message := here.recv())[0] == "tick":
                tick(message[1])
        except EOFError:
            message = "error", UserError("a process of this command was killed; is memory short?")
        process.join()
        kind, value = message
        if kind == "error":
            raise value
        return value

    return result


def _prepare(address: str | None) -> None:
    """Set the environment variables that Ray reads at import, unless they are set."""
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
    """Return the package ray; raises UserError if it is not installed."""
    try:
        import ray

        ray.init  # noqa: B018 (a folder named ray, such as Ray's own in /tmp, imports as a package)
    except (ImportError, AttributeError) as error:
        raise UserError(
            f"{option} needs Ray, which is not installed; pip install 'inclined-landing[ray]'"
        ) from error
    logging.getLogger("ray").setLevel(logging.ERROR)
    return ray


class _Cluster(Executor):
    """Calls functions on the machines of a Ray cluster, each call on one core.

    Exceptions of a call are raised here as a subclass of both the original exception and Ray's.
    """

    def __init__(self, ray):
        self.ray = ray
        self._remote = ray.remote(num_cpus=1, max_retries=_RETRIES)(_called)
        self._versions = runs.packages()

    def submit(self, function: Callable, /, *arguments: Any) -> Future:  # type: ignore[override]
        """Return the future result of a call."""
        remote = self._remote.options(name=function.__name__)
        return remote.remote(self._versions, function, *arguments).future()


@contextlib.contextmanager
def _connected(address: str | None) -> Iterator[_Cluster]:
    """Yield the cluster at the address HOST:PORT; without one, Ray is started for this machine only.

    Raises UserError if it cannot be reached, and for calls that it could not execute. Pending calls end with
    the context.
    """
    ray = import_ray()
    quiet = {"include_dashboard": False, "log_to_driver": False, "configure_logging": False}
    try:
        # Ray's workers import from the folder that it is started in, before any other.
        with _signals_kept(), contextlib.chdir(Path(sys.executable).parent):
            ray.init(address or "local", **quiet)
    except (OSError, ValueError, RuntimeError, ImportError) as error:
        where = f"at {shown(address)}" if address else "on this machine"
        hint = "; is this machine a node of the cluster, with its token?" if address else ""
        raise UserError(f"Ray cannot be reached {where}: {shown(error, 150)}{hint}") from error
    try:
        yield _Cluster(ray)
    except ray.exceptions.RayError as error:
        if isinstance(cause := getattr(error, "cause", None), UserError):
            raise cause from error
        last = (str(error).strip().splitlines() or ["no reason given"])[-1]
        raise UserError(f"Ray gave up: {shown(last, 400)}") from error
    finally:
        ray.shutdown()


@contextlib.contextmanager
def _signals_kept() -> Iterator[None]:
    """Keep the handler of SIGTERM, which Ray replaces."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):  # not in the main thread
            signal.signal(signal.SIGTERM, before)


def _called(versions: dict, function: Callable, *arguments: Any) -> Any:
    """Return what a call returns, on a machine of the cluster."""
    node = os.uname().nodename
    for name, version in runs.packages().items():
        if version != versions[name]:
            raise UserError(
                f"{node} has {name} {version}, but this machine has {versions[name]}; all machines "
                "of a cluster need the same packages"
            )
    return function(*arguments)


def _knock(address: str) -> None:
    """Raise UserError unless something listens at the address; Ray itself would keep trying for longer."""
    host, _, port = address.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and len(port) <= 5) or not 0 < int(port) < 65536:
        raise UserError(f"--address must be HOST:PORT, not {shown(repr(address))}")
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
    except (OSError, ValueError) as error:  # ValueError: no name of a host
        raise UserError(f"no Ray cluster answers at {shown(address)}: {storage.reason(error)}") from error
