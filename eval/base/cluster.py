"""A Ray cluster, for whoever asks for one."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

_PATIENCE = 5.0  # s to wait for a connection


def check(address: str | None, option: str) -> None:
    """Raise UserError unless Ray is installed and, where an address HOST:PORT is given, something answers.

    option: the one that asks for Ray, as sentences name it.
    """
    import_ray(option)
    if address is not None:
        _knock(address)


def import_ray(option: str = "Ray"):
    """The package ray; raises UserError where it is not installed."""
    try:
        import ray

        ray.init  # noqa: B018 (a folder named ray, such as Ray's own in /tmp, imports as a package)
    except (ImportError, AttributeError) as error:
        raise UserError(
            f"{option} needs Ray, which is not installed; pip install 'inclined-landing[ray]'"
        ) from error
    return ray


@contextlib.contextmanager
def connected(address: str | None) -> Iterator:
    """Ray, connected to the cluster at the address; None starts it on this machine."""
    ray = import_ray()
    began = not ray.is_initialized()
    if began:
        try:
            ray.init(address=address, include_dashboard=False, log_to_driver=False, configure_logging=False)
        except (ConnectionError, ValueError, RuntimeError, OSError) as error:
            where = f"at {address}" if address else "on this machine"
            raise UserError(f"Ray cannot be reached {where}: {shown(error, 150)}") from error
    try:
        yield ray
    finally:
        if began:
            ray.shutdown()


def answer(ray, reference, what: str):
    """The result of a task; raises UserError, beginning with `what`, where it has none."""
    try:
        return ray.get(reference)
    except ray.exceptions.RayError as error:
        last = (str(error).strip().splitlines() or ["no reason given"])[-1]
        raise UserError(f"{what} failed on Ray: {last}") from error


def _knock(address: str) -> None:
    """Raise UserError unless something listens at the address: Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and len(port) <= 5) or not 0 < int(port) < 65536:
        raise UserError(f"--address must be HOST:PORT, not {shown(repr(address))}")
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
    except (OSError, ValueError) as error:  # ValueError: no name of a host
        raise UserError(f"no Ray cluster answers at {shown(address)}: {storage.reason(error)}") from error
