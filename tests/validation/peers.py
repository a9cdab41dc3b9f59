"""`peers`: other quadrotor simulators and the plants of this package, in one run.

SCIPY_ARRAY_API=1 python -m tests.validation peers --out DIR writes DIR/peers.json and DIR/peers.md. Crazyflow
needs the variable before SciPy is imported.

Each function of `PEERS` builds a simulation and returns a call that advances it, with what the call contains.
No two calls contain the same: the table says so in its columns, and a speed without them means little.
"""

from __future__ import annotations

import dataclasses
import importlib
import importlib.metadata
import os
import time
from collections.abc import Callable
from typing import Any

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

PERIOD = 0.02  # s, of a control step
VEHICLES = 4096  # of a simulator that flies many at a time
_CONTENTS = ("contact", "task", "precision", "integrator")
_SPEEDS = ("steps_per_second", "steps_per_cpu_second")
COLUMNS = ("simulator", *_CONTENTS, "vehicles", "per second", "per CPU second")
_EXTRA = "pip install 'inclined-landing[baselines]'"


@dataclasses.dataclass(frozen=True)
class Simulation:
    """A running simulation, and what one call of `step` contains.

    step: advances all vehicles by `seconds`, and returns once their states are computed.
    contact: how surfaces act on vehicles. task: the one whose observation, reward and resets are included.
    """

    step: Callable[[], Any]
    vehicles: int
    contact: str
    task: str
    precision: str
    integrator: str
    seconds: float = PERIOD


@dataclasses.dataclass(frozen=True)
class Peer:
    """A simulator: how it is built for a number of vehicles and a seed, and how it is installed.

    modules: what must be importable. package: whose version is stated. install: the command.
    """

    build: Callable[[int, int], Simulation]
    modules: tuple[str, ...] = ()
    package: str = "inclined-landing"
    install: str = ""


def _ours(kind: str, contact: str, integrator: str) -> Peer:
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

    return Peer(build)


def _crazyflow(dynamics: str, integrator: str, rate: int) -> Peer:
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
        return Simulation(step, vehicles, "floor (height clipped)", "none", "32 bits", used)

    return Peer(build, ("crazyflow", "jax"), "crazyflow", _EXTRA)


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

    return Simulation(step, n, "none", "none", "64 bits", "RK4, 250 Hz")


def _pyflyt(vehicles: int, seed: int) -> Simulation:
    from PyFlyt.core import Aviary

    place = np.array([[0.0, 0.0, 1.0]])
    world = Aviary(place, np.zeros((1, 3)), "quadx", drone_options={"drone_model": "cf2x"}, seed=seed)
    world.set_mode(3)  # angles and height
    world.set_setpoint(0, np.array([0.05, 0.0, 0.0, 1.0]))
    return Simulation(world.step, 1, "Bullet", "none", "64 bits", "Bullet, 240 Hz", 1 / 120)


PEERS: dict[str, Peer] = {
    "this package, hybrid": _ours("hybrid", "MuJoCo", "exact loops, RK3, 100 Hz; near surfaces RK4, 250 Hz"),
    "this package, analytic": _ours("analytic", "detected, not simulated", "RK4, 50 Hz"),
    "this package, mujoco": _ours("mujoco", "MuJoCo", "RK4, 250 Hz"),
    "Crazyflow, rotors": _crazyflow("first_principles", "rk4", 500),
    "Crazyflow, quickest": _crazyflow("so_rpy", "euler", 250),
    "RotorPy, batch": Peer(_rotorpy, ("rotorpy", "torch", "torchdiffeq", "roma"), "rotorpy", _EXTRA),
    "PyFlyt": Peer(_pyflyt, ("PyFlyt",), "PyFlyt", "pip install PyFlyt"),
}


def rates(
    vehicles: int, seed: int, *, repeats: int = 5, seconds: float = 0.5, peers: dict[str, Peer] | None = None
) -> list[dict[str, Any]]:
    """Return a row for each simulator, with its control steps of 20 ms per second; `missing` says why not.

    A control step is one vehicle's. The simulators take turns of `seconds`, so that other load meets all.
    """
    peers = PEERS if peers is None else peers
    rows: list[dict[str, Any]] = []
    running: list[tuple[dict[str, Any], Simulation, list[float], list[float]]] = []
    with stages(len(peers) * (repeats + 2)) as tick:
        for name, peer in peers.items():
            tick(name)
            row, simulation = _built(name, peer, vehicles, seed)
            rows.append(row)
            if simulation is not None:
                running.append((row, simulation, [], []))
        for repeat in range(repeats + 1):
            for row, simulation, *measured in running:
                tick(row["simulator"])
                if repeat:
                    for rate, values in zip(_rates(simulation, seconds), measured):
                        values.append(rate)
                else:  # warms up
                    _rates(simulation, seconds)
    for row, _, wall, cpu in running:
        row |= {"steps_per_second": spread(wall), "steps_per_cpu_second": spread(cpu)}
    return rows


def _built(name: str, peer: Peer, vehicles: int, seed: int) -> tuple[dict[str, Any], Simulation | None]:
    """Return the row of a simulator and its simulation, stepped once, or None where it does not run."""
    row: dict[str, Any] = {"simulator": name}
    try:
        for module in peer.modules:
            importlib.import_module(module)
        row["version"] = importlib.metadata.version(peer.package)
        simulation = peer.build(vehicles, seed)
        simulation.step()  # compiles
    except ImportError as error:
        return row | {"missing": f"not installed ({error.name or error}): {peer.install}"}, None
    except Exception as error:  # its programming interface has changed, for example: the others still run
        return row | {"missing": f"does not run: {type(error).__name__}: {error}".splitlines()[0]}, None
    return row | {field: getattr(simulation, field) for field in ("vehicles", *_CONTENTS)}, simulation


def _rates(simulation: Simulation, seconds: float) -> tuple[float, float]:
    """Return control steps per second of wall and of CPU time, over at least `seconds` of wall time."""
    calls, wall, cpu = 0, time.perf_counter(), time.process_time()
    while calls == 0 or time.perf_counter() - wall < seconds:
        simulation.step()
        calls += 1
    steps = calls * simulation.vehicles * simulation.seconds / PERIOD
    return steps / (time.perf_counter() - wall), steps / (time.process_time() - cpu)


def cells(row: dict[str, Any]) -> list[str]:
    """Return the cells of a row under `COLUMNS`."""
    if "missing" in row:
        return [row["simulator"], row["missing"], *[""] * (len(COLUMNS) - 2)]
    speeds = [spread_cell(row[name], 0, ends=("min", "max")) for name in _SPEEDS]
    contents = [row[name] for name in _CONTENTS]
    return [f"{row['simulator']} {row['version']}", *contents, str(row["vehicles"]), *speeds]


def markdown(rows: list[dict[str, Any]], machine: str) -> str:
    """Return machine and table as Markdown."""
    lines = [COLUMNS, ["---"] * len(COLUMNS), *map(cells, rows)]
    return machine + "\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in lines)


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
    page = markdown(report["peers"], machine_line(report))
    print(page)
    if out is not None:
        with staged_run(out) as folder:
            storage.write_json(folder / "peers.json", report)
            storage.write_text(folder / "peers.md", page)
