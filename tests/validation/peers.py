"""`peers`: other quadrotor simulators and the plants of this package, in one run.

SCIPY_ARRAY_API=1 python -m tests.validation peers --out DIR writes DIR/peers.json and DIR/peers.md. Crazyflow
needs the variable before SciPy is imported.

Each function of `PEERS` builds a simulation and returns a call that advances it, with what the call contains.
No two calls contain the same: the table says so in its columns, and a speed without them means little.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import os
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.shared.options import NewFolder, Seed
from inclined_landing.envs.shared.runs import staged_run, versions
from inclined_landing.envs.shared.statistics import spread
from inclined_landing.envs.shared.tables import spread_cell
from inclined_landing.envs.tasks import make_task
from inclined_landing.eval.base.progress import stages
from inclined_landing.eval.machine.benchmark import machine_line
from inclined_landing.models.base import storage
from inclined_landing.models.plants import make_plant

from .shared import table_of

PERIOD = 0.02  # s, of a control step
_CONTENTS = ("contact", "task", "precision", "integrator", "vehicles")
_SPEEDS = ("per_second", "per_CPU_second")
VEHICLES = 4096  # of a simulator that flies many at a time
INSTALL = "pip install 'inclined-landing[baselines]' PyFlyt"


@dataclasses.dataclass(frozen=True)
class Simulation:
    """A running simulation, and what one call of `step` contains.

    step: advances all vehicles by `seconds`, and returns once their states are computed.
    contact: how surfaces act on vehicles. task: the one whose observation, reward and resets are included.
    package: whose version is stated.
    """

    step: Callable[[], Any]
    vehicles: int
    contact: str
    task: str
    precision: str
    integrator: str
    package: str = "inclined-landing"
    seconds: float = PERIOD


Build: TypeAlias = Callable[[int, int], Simulation]  # for a number of vehicles, from a seed


def _ours(kind: str, contact: str, integrator: str) -> Build:
    def build(vehicles: int, seed: int) -> Simulation:
        rng = np.random.default_rng(seed)
        task = make_task("landing", pwm_centre="hover")
        batch = BatchEnv(task, make_plant(kind, vehicles, task.vehicle), seed)
        env = BatchVecEnv(batch)
        env.reset()
        batch.length[:] = rng.integers(0, task.max_steps, vehicles)  # so that resets spread evenly
        size = vehicles, len(task.action_names)

        def step() -> None:
            action = rng.uniform(-0.3, 0.3, size)
            action[:, 0] += 0.12  # of the thrust: a little over hover, as the other simulators' commands
            env.step(action)

        return Simulation(step, vehicles, contact, "landing", "64 bits", integrator)

    return build


def _crazyflow(dynamics: str, integrator: str, rate: int) -> Build:
    def build(vehicles: int, seed: int) -> Simulation:
        import jax
        from crazyflow.sim import Sim

        rates = {"freq": rate, "attitude_freq": rate}
        sim = Sim(n_worlds=vehicles, dynamics=dynamics, control="attitude", integrator=integrator, **rates)
        sim.reset()
        rng = np.random.default_rng(seed)

        def step() -> None:
            command = rng.uniform(-0.3, 0.3, (vehicles, 1, 4)).astype(np.float32)
            command[..., 3] += 0.35  # N
            sim.attitude_control(command)
            sim.step(round(PERIOD * rate))
            jax.block_until_ready(sim.data.states.pos)

        used = f"{integrator}, {rate} Hz ({dynamics})"
        return Simulation(step, vehicles, "floor (height clipped)", "none", "32 bits", used, "crazyflow")

    return build


def _rotorpy(vehicles: int, seed: int) -> Simulation:
    import torch
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams

    cpu, n = torch.device("cpu"), vehicles
    params = BatchedMultirotorParams([quad_params] * n, n, cpu)
    zeros, level = torch.zeros(n, 3).double(), torch.tensor([[0.0, 0.0, 0.0, 1.0]] * n).double()
    state = {
        **{"x": zeros, "v": zeros, "q": level, "w": zeros, "wind": zeros},
        "rotor_speeds": torch.full((n, 4), 1800.0).double(),
    }
    plant = BatchedMultirotor(params, n, state, cpu, "cmd_motor_speeds", integrator="rk4")
    rng, now = np.random.default_rng(seed), [state]

    def step() -> None:
        speeds = torch.from_numpy(1800.0 + rng.uniform(-10, 10, (n, 4)))
        for _ in range(5):
            now[0] = plant.step(now[0], {"cmd_motor_speeds": speeds}, PERIOD / 5)

    return Simulation(step, n, "none", "none", "64 bits", "RK4, 250 Hz", "rotorpy")


def _pyflyt(vehicles: int, seed: int) -> Simulation:
    from PyFlyt.core import Aviary

    place = np.array([[0.0, 0.0, 1.0]])
    world = Aviary(place, np.zeros((1, 3)), "quadx", drone_options={"drone_model": "cf2x"}, seed=seed)
    world.set_mode(3)  # angles and height
    world.set_setpoint(0, np.array([0.05, 0.0, 0.0, 1.0]))
    return Simulation(world.step, 1, "Bullet", "none", "64 bits", "Bullet, 240 Hz", "PyFlyt", 1 / 120)


PEERS: dict[str, Build] = {
    "this package, hybrid": _ours("hybrid", "MuJoCo", "exact loops, RK3, 100 Hz; near surfaces RK4, 250 Hz"),
    "this package, analytic": _ours("analytic", "detected, not simulated", "RK4, 50 Hz"),
    "this package, mujoco": _ours("mujoco", "MuJoCo", "RK4, 250 Hz"),
    "Crazyflow, rotors": _crazyflow("first_principles", "rk4", 500),
    "Crazyflow, quickest": _crazyflow("so_rpy", "euler", 250),
    "RotorPy, batch": _rotorpy,
    "PyFlyt": _pyflyt,
}


def rates(
    vehicles: int,
    seed: int,
    *,
    repeats: int = 5,
    seconds: float = 0.5,
    peers: Mapping[str, Build] = PEERS,
) -> list[dict[str, Any]]:
    """Return a row for each simulator, with its control steps of 20 ms per second, or why there are none.

    A control step is one vehicle's. The simulators take turns of `seconds`, so that other load meets all.
    """
    rows = {name: dict.fromkeys(("simulator", *_CONTENTS, *_SPEEDS)) | {"simulator": name} for name in peers}
    running: dict[str, tuple[Simulation, list[tuple[float, float]]]] = {}
    with stages(len(peers) * (repeats + 2), "turns") as tick:
        for name, build in peers.items():
            tick(name)
            try:
                simulation = build(vehicles, seed)
                simulation.step()  # compiles
                rows[name] |= {key: getattr(simulation, key) for key in _CONTENTS}
                rows[name]["simulator"] = f"{name} {importlib.metadata.version(simulation.package)}"
                running[name] = simulation, []
            except ImportError as error:
                rows[name]["contact"] = f"not installed ({error.name or error}): {INSTALL}"
            except Exception as error:  # its programming interface has changed, for example
                words = f"does not run: {type(error).__name__}: {error}"
                rows[name]["contact"] = words.splitlines()[0]
        for _ in range(repeats + 1):
            for name, (simulation, measured) in running.items():
                tick(name)
                measured.append(_rates(simulation, seconds))
    for name, (_, measured) in running.items():
        turns = zip(*measured[1:])  # the first one warms up
        rows[name] |= {key: spread(values) for key, values in zip(_SPEEDS, turns)}
    return list(rows.values())


def _rates(simulation: Simulation, seconds: float) -> tuple[float, float]:
    """Return control steps per second of wall and of CPU time, over at least `seconds` of wall time."""
    calls, wall, cpu = 0, time.perf_counter(), time.process_time()
    while calls == 0 or time.perf_counter() - wall < seconds:
        simulation.step()
        calls += 1
    steps = calls * simulation.vehicles * simulation.seconds / PERIOD
    return steps / (time.perf_counter() - wall), steps / (time.process_time() - cpu)


def command(*, vehicles: int = VEHICLES, seed: Seed = 0, out: NewFolder = None) -> None:
    """Measure control steps per second of the plants and of the other simulators that are installed.

    Args:
        vehicles: number of vehicles of the simulators that fly many at a time.
        seed: seed of the actions.
        out: new folder for peers.json and peers.md.
    """
    report: dict[str, Any] = {"seed": seed, "versions": versions(), "load_before": os.getloadavg()}
    report["peers"] = rates(vehicles, seed)
    report["load_after"] = os.getloadavg()
    cells = [
        row | {key: spread_cell(row[key], 0, ends=("min", "max")) for key in _SPEEDS if row[key]}
        for row in report["peers"]
    ]
    page = machine_line(report) + "\n\n" + table_of(cells)
    print(page)
    if out is not None:
        with staged_run(out) as folder:
            storage.write_json(folder / "peers.json", report)
            storage.write_text(folder / "peers.md", page)
