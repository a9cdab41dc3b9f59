"""`Engine`: a `mujoco.batch.Batch` that can be copied and pickled, and detects that a fork lost its threads.

Threads do not survive a fork. In the child process the engine's next call would wait for them forever, and so
would its destructor: such an engine is kept in memory until the process ends, and a copy replaces it. A fork
waits for calls in other threads, so that no engine is copied in the middle of one.
"""

from __future__ import annotations

import ctypes
import os
import threading
import weakref
from collections.abc import Sequence
from operator import attrgetter
from typing import NamedTuple

import mujoco
import mujoco.batch
import numpy as np

from inclined_landing.models import plugins

plugins.stop_profile()
_engines: weakref.WeakSet[Engine] = weakref.WeakSet()
_forking = threading.Lock()
_locked: list[Engine] = []  # during a fork


class Columns(NamedTuple):
    """The columns of `Engine.state` (n, s) at which its components begin, for kernels.

    Kernels take whole rows, because views of the columns have another layout if n is 1, for which everything
    would be compiled again.
    """

    time: int
    qpos: int
    qvel: int
    act: int
    history: int
    warmstart: int
    ctrl: int
    mocap_pos: int
    nv: int  # number of degrees of freedom, size of qvel and warmstart

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Columns:
        """Return the columns for simulations of a model, whose components are in the order of their bits."""
        bits = [int(getattr(mujoco.mjtState, f"mjSTATE_{name.upper()}")) for name in cls._fields[:-1]]
        before = [int(mujoco.mjtState.mjSTATE_INTEGRATION) & (bit - 1) for bit in bits]
        return cls._make([*(mujoco.mj_stateSize(model, mask) for mask in before), model.nv])


class Engine(mujoco.batch.Batch):
    """n simulations of a model on several threads.

    lost: whether this is a forked process without the threads. A copy has its own threads.
    """

    def __init__(self, model: mujoco.MjModel, n: int, threads: int):
        super().__init__(model, n, threads)
        self.lost = False
        self.calling = threading.Lock()
        _engines.add(self)

    def rollout(self, *arguments, **options):
        """See `mujoco.batch.Batch.rollout`."""
        with self.calling:
            return super().rollout(*arguments, **options)

    def set_const(self, *arguments, **options) -> None:
        """See `mujoco.batch.Batch.set_const`."""
        with self.calling:
            super().set_const(*arguments, **options)

    def __reduce__(self):
        fields = {name: self.expanded(name) for name in mujoco.batch.MODEL_FIELDS}
        fields = {name: np.array(values) for name, values in fields.items() if values is not None}
        return _copied, (self.model, self.nsim, self.nthread, self.state, self.warning, fields)


def _copied(model, n: int, threads: int, state: np.ndarray, warning: np.ndarray, fields: dict) -> Engine:
    """Return an engine with the states (n, s) of another, its warnings and the fields of its simulations."""
    engine = Engine(model, n, threads)
    engine.state[:], engine.warning[:] = state, warning
    for name, values in fields.items():
        engine.expand(name)[:] = values
    return engine


def _hold() -> None:
    _forking.acquire()
    _locked[:] = _engines
    for engine in _locked:
        engine.calling.acquire()


def _release() -> None:
    for engine in _locked:
        engine.calling.release()
    _locked.clear()
    _forking.release()


def _lose() -> None:
    for engine in _engines:
        engine.lost = True
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(engine))
    _release()


os.register_at_fork(before=_hold, after_in_parent=_release, after_in_child=_lose)


def differing_fields(models: Sequence[mujoco.MjModel]) -> dict[str, np.ndarray]:
    """Return the fields, (m, ...) each, in which models of one layout differ and a batch may differ.

    Names, keyframes and the text of plugins, whose numbers are included, are omitted.
    """
    fields = {}
    for name in sorted(mujoco.batch.MODEL_FIELDS if len(models) > 1 else ()):
        if name.startswith(("name", "key_", "plugin_attr")):
            continue
        rows = np.stack([attrgetter(name)(model) for model in models])
        if (rows != rows[0]).any():
            fields[name] = rows
    return fields


def held_histories(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the history buffer at time 0: empty (h,), and the change by one unit of each control (nu, h)."""
    data = mujoco.MjData(model)
    empty, per_unit = data.history.copy(), np.zeros((model.nu, model.nhistory))
    for actuator in range(model.nactuator):
        samples = model.actuator_history[actuator, 0]
        if samples:
            mujoco.mj_initCtrlHistory(model, data, actuator, None, np.ones(samples))
            per_unit[model.actuator_ctrladr[actuator]] = data.history - empty
            data.history[:] = empty
    return empty, per_unit
