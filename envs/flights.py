"""Recorded flights of a policy, the only source of success tables, figures and videos."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from inclined_landing.envs.batch import BatchEnv, as_floats, is_whole
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import Start, Task
from inclined_landing.models import geometry
from inclined_landing.models.attitude import PITCH, YAW, Z
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.motion import MODES, Motion
from inclined_landing.models.plants import MujocoPlant, Plant, make_plant
from inclined_landing.models.plants.base import PLATFORM_SIZE
from inclined_landing.models.plants.recorder import STEP, present_forces

_FREE = 0.01  # m from every surface, where nothing can touch
_NONE = np.zeros((0, 3))


@dataclasses.dataclass(kw_only=True)
class Track:
    """The recorded path of one vehicle at the control rate, T = steps + 1 rows.

    Row k of `commands` was applied from t[k] to t[k + 1]; the last row repeats the one before.
    """

    task: Task  # the one that the flight is scored by
    t: np.ndarray  # (T,) s
    state: np.ndarray  # (T, 13), columns of `models.attitude`
    commands: np.ndarray  # (T, 4) PWM, rad, rad, rad/s
    inclination: float | None  # of the platform, rad; None without one
    # (T, 12), columns as `Plant.platform`: where the platform is. None where it stands still and is not
    # turned.
    platform: np.ndarray | None = None
    motion: Motion | None = None  # (1) of the platform; None of one that stands on its base

    def __post_init__(self):
        if self.inclination is None:
            self.platform = None
        elif self.platform is None:
            self.platform = np.zeros((len(self.t), PLATFORM_SIZE))
            self.platform[:, Z], self.platform[:, PITCH] = (
                self.task.vehicle.platform_surface_height,
                self.inclination,
            )

    @property
    def goals(self) -> list[np.ndarray]:
        """Return the goal states (13,) of the flight."""
        goal = self.task.goal_on(None if self.platform is None else self.platform[-1])
        return [] if goal is None else [goal]


@dataclasses.dataclass(kw_only=True)
class Flight(Track):
    """One flight of one policy, from its start to the goal or the time limit."""

    actions: np.ndarray  # (T, a) in [-1, 1], rows as those of `commands`
    reward: np.ndarray  # (T,), of the step that ended at t[k]; 0 at the start
    success: bool  # at the end, as the task judges it
    touched: bool  # did any part touch the platform

    @property
    def strict(self) -> bool:
        """Whether the flight succeeded without touching the platform."""
        return self.success and not self.touched

    @property
    def duration(self) -> float:
        """Length of the flight [s]."""
        return float(self.t[-1])


class Actor(Protocol):
    """A policy, or an object with the same interface."""

    @property
    def task(self) -> Task: ...

    def predict(self, observation: np.ndarray) -> np.ndarray: ...


def record_flights(
    policy: Actor,
    plant,
    states: np.ndarray | Start,
    *,
    steps: int | None = None,
    informed: bool = True,
    contact_limit: int | None = None,
) -> list[Flight]:
    """Fly the deterministic policy from each of `states` (n, 13) or n starts at once, and return the flights.

    For states, the platforms are those of `Task.start`; starts contain their platforms and contact
    parameters.

    Args:
        policy: a policy from `load_policy`.
        plant (Plant | str): a plant of n vehicles, or "mujoco", "hybrid" or "analytic" to make one for the
            task's vehicle.
        states: states (n, 13) or n starts.
        steps: fly at most this many control steps (default: the task's limit).
        informed: see `BatchEnv`.
        contact_limit: end a flight, without success, after this many control steps in contact with a
            surface (default: never).

    Raises:
        UserError: when the number of states is not the plant's.
        FloatingPointError: when the engine diverges.

    Flights of vehicles from a pool may diverge far outside the arena, where drawn effects of the air can add
    unlimited thrust; they end there without success instead.
    """
    if not isinstance(getattr(policy, "task", None), Task):
        raise UserError(f"policy must be one that load_policy returns, not {shown(repr(policy), 40)}")
    start = states if isinstance(states, Start) else None
    states = np.atleast_2d(as_floats(states, "the start state")) if start is None else start.state
    if isinstance(plant, str):
        plant = make_plant(plant, len(states), policy.task.vehicle, **policy.task.plant_options)
    if not hasattr(plant, "step"):
        raise UserError(f"plant must be a plant or the name of one, not {shown(repr(plant), 40)}")
    if plant.n != len(states):
        raise UserError(f"the plant has {plant.n} vehicles, but {len(states)} starts were given")
    env = BatchEnv(policy.task, plant, seed=0, informed=informed)
    limit = policy.task.max_steps if steps is None else steps
    if not (is_whole(limit) and 1 <= limit <= policy.task.max_steps):
        raise UserError(f"a flight must have 1 to {policy.task.max_steps} control steps, not {limit}")
    observation = env.reset(state=states) if start is None else env.reset(start=start)
    n = len(states)
    state, platform = (np.empty((limit + 1, *now.shape)) for now in (plant.state, plant.platform))
    actions, commands = np.zeros((limit, *env.actions.shape)), np.empty((limit, *env.commands.shape))
    reward = np.zeros((limit + 1, n))
    state[0], platform[0] = plant.state, plant.platform
    ended = np.zeros(n, int)  # index of the last row; 0 while flying
    success, touched = np.zeros(n, bool), np.zeros(n, bool)
    in_contact = np.zeros(n, int)  # steps up to now
    last = 0
    while last < limit and not ended.all():
        flying = ended == 0
        if isinstance(policy, Policy):  # which has no memory, so it need not see those that have ended
            actions[last, flying] = policy.predict(observation[flying])
        else:
            actions[last] = policy.predict(observation)
        env.act(actions[last])
        lost = np.zeros(n, bool)
        try:
            plant.step(env.commands, flying)
        except FloatingPointError:
            if not plant.pool:
                raise
            lost = plant.diverged
            plant.reset(np.flatnonzero(lost), state[0, lost])  # and stands still there from now on
        step = env.outcome()
        observation = step.observation
        commands[last] = env.commands
        last += 1
        state[last], reward[last], platform[last] = plant.state, step.reward, plant.platform
        state[last, lost] = state[last - 1, lost]
        if contact_limit is not None:
            in_contact += plant.contacts.platform | plant.contacts.floor
            lost |= (in_contact >= contact_limit) & ~step.terminated
        now = flying & (step.terminated | step.truncated | lost | (last == limit))
        ended[now] = last
        success[now], touched[now] = step.success[now], env.touched[now]
    flights = []
    for i, end in enumerate(ended):
        rows, acting, there = slice(end + 1), np.minimum(np.arange(end + 1), end - 1), plant.present[i]
        flight = Flight(
            task=policy.task,
            t=plant.control_period * np.arange(end + 1),
            state=state[rows, i].copy(),
            actions=actions[acting, i],
            commands=commands[acting, i],
            reward=reward[rows, i].copy(),
            inclination=float(platform[0, i, PITCH]) if there else None,
            platform=platform[rows, i].copy() if there else None,
            motion=plant.motion[[i]] if plant.motion is not None and there else None,
            success=bool(success[i]),
            touched=bool(touched[i]),
        )
        flights.append(flight)
    return flights


@dataclasses.dataclass
class Resimulation:
    """A flight at the engine's steps, T of them including the start.

    Row k of `commands` was applied from t[k] on; points and forces belong to the state in row k.
    """

    t: np.ndarray  # (T,) s
    state: np.ndarray  # (T, 13)
    commands: np.ndarray  # (T, 4) PWM, rad, rad, rad/s
    points: list[np.ndarray]  # T arrays (k, 3) m, contacts that carry force
    forces: list[np.ndarray]  # T arrays (k, 3) N, on the vehicle
    platform: np.ndarray | None  # (T, 12), as `Track.platform`


def place_platform(plant: Plant, flight: Track, time: float = 0.0) -> None:
    """Set the platform of a flight for the only vehicle of a plant, as it is `time` [s] after the start."""
    if flight.platform is None:
        return plant.set_platform([0], 0.0, False)
    pitch, yaw = flight.platform[0, [PITCH, YAW]]
    if flight.motion is None:
        return plant.set_platform([0], pitch, azimuth=yaw)
    swing = dict(zip(MODES, flight.motion.at(flight.t[0])[0][0]))
    plant.set_platform([0], pitch - swing["pitch"], azimuth=yaw - swing["yaw"])
    plant.set_motion([0], flight.motion, time)


def resimulate(flight: Flight) -> Resimulation:
    """Return a flight simulated again in the MuJoCo plant from its commands, at engine steps with all
    contacts.

    For flights of that plant in still air the states are reproduced bit for bit; over a moving platform they
    are reproduced to a micrometre, the error of its pose within a control period.
    """
    vehicle = flight.task.vehicle
    substeps = round(vehicle.command_control_period / STEP)
    moving = flight.motion is not None
    plant = MujocoPlant(
        1, vehicle, control_period=STEP, timestep=STEP, torque_needs_motors=True, threads=1, moving=moving
    )
    place_platform(plant, flight)
    plant.reset([0], flight.state[:1])
    shapes, slope = geometry.shapes_of(plant.model), (plant.inclination, plant.present)
    centres = geometry.platform_poses(*slope, vehicle, azimuth=plant.azimuth)[0]

    def seen():
        """Return the present state, platform state, contact points and forces (none far from surfaces)."""
        to = geometry.clearances(plant.state, plant.inclination, centres, shapes, azimuth=plant.azimuth)
        free = to.min() > _FREE and not moving
        met = (_NONE, _NONE) if free else present_forces(plant, 0)
        return plant.state[0].copy(), plant.platform[0].copy(), *met

    commands = np.repeat(flight.commands[:-1], substeps, axis=0)
    rows = [seen()]
    for command in commands:
        plant.step(command[None])
        rows.append(seen())
    states, platforms, points, forces = (list(column) for column in zip(*rows))
    t = STEP * np.arange(len(rows))
    platform = None if flight.platform is None else np.array(platforms)
    return Resimulation(
        t, np.array(states), np.concatenate([commands, commands[-1:]]), points, forces, platform
    )
