"""RotorPy's Crazyflie as a reality: its equations of motion, its mixer and its controllers, not ours.

All flights of a case are one batch of `rotorpy.vehicles.multirotor.BatchedMultirotor`, integrated by the
midpoint rule. The pilot is RotorPy's SE3 controller (50 Hz, on the measured state): its thrust and
orientation are the logged PWM, roll and pitch. The vehicle turns what it receives into rotor speeds with
RotorPy's `cmd_ctatt` loop (250 Hz). Where RotorPy has a parameter for a hidden cause (mass, coefficients of
thrust, drag and lift, motor lag, gain of the attitude loop, wind), that parameter differs; the rest is
added where commands and poses pass. There is no ground effect: flights keep clear of the floor.

RotorPy is a package of its own (MIT license): pip install 'inclined-landing[baselines]'.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from inclined_landing.models.base.errors import optional
from tests.validation.simulator import (
    KINDS,
    Build,
    Constants,
    Reality,
    Recording,
    World,
    constants,
    control,
    ordinary,
)
from tests.validation.simulator.family import between
from tests.validation.simulator.flight import correlated, heard
from tests.validation.simulator.vehicle import PILOT_RATE

from .causes import Drawn

with optional():
    import roma  # noqa: F401 (RotorPy's batch needs it)
    import torch
    import torchdiffeq  # noqa: F401
    from rotorpy.controllers.quadrotor_control import BatchedSE3Control
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams
    from rotorpy.wind.dryden_winds import BatchedDrydenGust

_CPU = torch.device("cpu")
RATE = 250  # Hz, of the flight controller and of the integration
_POSITION_GAINS, _HEIGHT_GAINS = (6.5, 4.0, 0.0), (15.0, 9.0, 0.0)  # RotorPy's kp_pos, kd_pos; no integral
WARM_UP = 2.0  # s flown before the log begins
LOWEST = 0.35  # m, of the references; a pilot without integral may be pressed down by a cause
_TOUCH, _FAR = 0.05, 4.0  # m, lowest and farthest centre of mass in a flight that counts
_TRIES = 10
_FILTER = (0.35, 0.06)  # alpha and beta of the pilot's filter of the position, every second period
# Columns of the state (n, 20) of a batch.
X, V, Q, W, WIND, ROTORS = (slice(*ends) for ends in ((0, 3), (3, 6), (6, 10), (10, 13), (13, 16), (16, 20)))


def draw(rng: np.random.Generator) -> Reality:
    """Draw a reality: RotorPy's Crazyflie with constants up to 10 % off, its air and its log."""
    about, c, p = lambda size=0.1: rng.uniform(1 - size, 1 + size), constants(), quad_params
    mass = p["mass"] * about()
    drag, stiff = about(), about()
    own = {
        "mass": mass,
        "inertia": tuple(p[name] * about() for name in ("Ixx", "Iyy", "Izz")),
        # The paper's hover PWM, up to 10 % off.
        "thrust_per_pwm": c.thrust_per_pwm * mass / c.mass * about(),
        "thrust_per_speed": p["k_eta"] * about(),
        "torque_ratio": p["k_m"] / p["k_eta"],
        "motor_time": p["tau_m"] * about(),
        "drag_per_speed": (p["k_d"] * drag, p["k_d"] * drag, p["k_z"] * about()),
        "attitude_gain": 1.0,
        "attitude_time": p["kd_att"] / p["kp_att"] * about(),
        "rate_bandwidth": p["kd_att"] * stiff,
        "position_gains": tuple(x * about() for x in _POSITION_GAINS),
        "height_gains": tuple(x * about() for x in _HEIGHT_GAINS),
    }
    c = c._replace(
        **own,
        battery_voltage=rng.uniform(3.85, 4.15),
        position_noise=between(rng, 0.0002, 0.003),
        attitude_noise=math.radians(between(rng, 0.05, 0.5)),
    )
    b = Build(
        disturbance=tuple(between(rng, 0.02, 0.15) for _ in range(3)),
        disturbance_time=between(rng, 0.1, 1.0),
        disturbance_torque=tuple(between(rng, 0.1, 1.0) * np.array([1.0, 1.0, 0.3])),
        log_ticks=float(rng.choice([2, 4, 6, 8, 10])),  # of 2 ms: 250 to 50 rows per second
    )
    return Reality(c, b, "rotorpy")


def flies(reality: Reality, w: World) -> bool:
    """Return whether the attitude loop is well inside stability.

    With gains kp on the angle and kd on the rate, and motors of first order, tau: by Routh tau kp < kd.
    """
    p = parameters(reality.constants, w)
    return p["tau_m"] * p["kp_att"] < 0.7 * p["kd_att"]


def parameters(c: Constants, w: World | None = None) -> dict:
    """Return RotorPy's parameters of the vehicle of `c`, in world `w` or nominal (as controllers assume)."""
    w = World() if w is None else w
    lateral, axial = c.drag_per_speed[0], c.drag_per_speed[2]
    k_eta = c.thrust_per_speed * w.thrust_scale
    return quad_params | {
        "mass": c.mass * w.mass_scale,
        **dict(zip(("Ixx", "Iyy", "Izz"), c.inertia)),
        "k_eta": k_eta,
        "k_m": k_eta * c.torque_ratio,
        "k_d": lateral * w.drag_scale * w.lateral_drag,
        "k_z": axial * w.drag_scale,
        "k_h": 0.25 * w.translational_lift * c.mass * c.gravity,  # share of the weight per (m/s)^2
        **dict.fromkeys(("c_Dx", "c_Dy", "c_Dz"), w.body_drag),
        "tau_m": c.motor_time * w.motor_time_scale,
        "kp_att": c.rate_bandwidth / (c.attitude_time * w.attitude_time_scale),
        "kd_att": c.rate_bandwidth,
    }


def vehicle(params: Sequence[dict], abstraction: str = "cmd_motor_speeds") -> BatchedMultirotor:
    """Return RotorPy's batch of vehicles with these parameters."""
    n = len(params)
    batch = BatchedMultirotorParams(list(params), n, _CPU)
    return BatchedMultirotor(batch, n, {"x": torch.zeros(n, 3)}, _CPU, abstraction)


def advance(plant: BatchedMultirotor, s, speeds, push, h: float):
    """Return RotorPy's state (n, 20) after h seconds at commanded rotor speeds (n, 4).

    push (n, 20) adds to its derivative.
    """
    every = torch.arange(len(s))
    speeds = torch.clip(speeds, plant.params.rotor_speed_min, plant.params.rotor_speed_max)
    middle = s + 0.5 * h * (plant._s_dot_fn(0.0, s, speeds, every) + push)
    s = s + h * (plant._s_dot_fn(0.0, middle, speeds, every) + push)
    s[:, Q] /= torch.linalg.norm(s[:, Q], dim=1, keepdim=True)
    return s


# Air, external forces, and commands and poses that are late or wrong: worlds hold arrays (n,) here, one entry
# for each flight of a batch.


def received(command: np.ndarray, w: World):
    """Return roll, pitch and yaw rate, each (n,), that the vehicle receives for commands (n, 4)."""
    angles = command[:, 1:3].copy()
    angles[np.abs(angles) < w.dead_zone[:, None]] = 0.0
    step = np.where(w.quantum > 0.0, w.quantum, 1.0)[:, None]
    angles = np.where(w.quantum[:, None] > 0.0, step * np.round(angles / step), angles)
    roll, pitch = angles[:, 0], angles[:, 1] + w.cross_coupling * angles[:, 0]
    gain = w.attitude_gain_scale
    return gain * (roll + w.trim_roll), gain * (pitch + w.trim_pitch), command[:, 3]


def wind_at(x: np.ndarray, w: World) -> np.ndarray:
    """Return the steady wind (n, 3) at positions x (n, 3), with a rising column."""
    squared = (x[:, 0] - w.updraft_x) ** 2 + (x[:, 1] - w.updraft_y) ** 2
    return np.column_stack([w.wind_x, w.wind_y, w.updraft * np.exp(-squared / (2.0 * w.updraft_radius**2))])


def external(q: np.ndarray, time: float, c: Constants, w: World) -> np.ndarray:
    """Return external accelerations (n, 3) [m/s2]: bias of thrust, a fan, a force with the heading."""
    push = Rotation.from_quat(q).apply([0.0, 0.0, 1.0]) * (w.thrust_bias / (c.mass * w.mass_scale))[:, None]
    swing = w.swing * np.sin(2.0 * np.pi * time / w.swing_period)
    heading = 2.0 * angles_of(q)[:, 2]
    push[:, 0] += swing * np.cos(w.swing_direction) + w.heading_force * np.cos(heading)
    push[:, 1] += swing * np.sin(w.swing_direction) + w.heading_force * np.sin(heading)
    return push


def disturbance(rng, shape: tuple[int, int, int], b: Build) -> np.ndarray:
    """Return accelerations [m/s2] and angular accelerations [rad/s2] (ticks, n, 6) of a build's air."""
    size = np.array([*b.disturbance, *b.disturbance_torque])
    return size * correlated(rng, shape, b.disturbance_time, RATE)


def delayed(history: np.ndarray, k, delay: np.ndarray) -> np.ndarray:
    """Return rows of history (ticks, n, m), `delay` (n,) [s] before period k (one, or (n,)), interpolated."""
    at = np.maximum(k - delay * RATE, 0.0)
    before = np.floor(at + 1e-9).astype(int)
    part, flight = np.maximum(at - before, 0.0)[:, None], np.arange(len(delay))
    after = np.minimum(before + 1, np.maximum(k, before))
    return (1.0 - part) * history[before, flight] + part * history[after, flight]


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the product of quaternions (n, 4), scalar last."""
    return (Rotation.from_quat(p) * Rotation.from_quat(q)).as_quat()


def attitude_of(yaw, roll, pitch) -> np.ndarray:
    """Return the quaternion (n, 4) of Rz(yaw) Rx(roll) Ry(pitch)."""
    return Rotation.from_euler("ZXY", np.column_stack([yaw, roll, pitch])).as_quat()


def angles_of(q: np.ndarray) -> np.ndarray:
    """Return roll, pitch, yaw (n, 3) of Rz Rx Ry."""
    return Rotation.from_quat(q).as_euler("ZXY")[:, [1, 2, 0]]


class Flights:
    """Flights side by side: their state (n, 20) and their record, period by period.

    The rotors' states are their speeds [rad/s].
    """

    def __init__(self, rows: np.ndarray, worlds: Sequence[World], rng, reality: Reality):
        self.rows, self.worlds, self.reality, n = rows, worlds, reality, len(worlds)
        c, b = reality.constants, reality.build
        self.w = w = World(*(np.array(column, float) for column in zip(*worlds)))
        ticks, level = len(rows) * RATE // PILOT_RATE, np.zeros(n)
        self.air, self.gust = disturbance(rng, (ticks, n, 6), b), self.gusts(rng, ticks)
        scale = [c.position_noise] * 3 + [c.attitude_noise] * 3
        self.noise = rng.standard_normal((ticks, n, 6)) * scale
        self.heard = heard(rng, ticks, w.command_jitter, RATE)
        self.level = attitude_of(level, w.level_roll, w.level_pitch)
        self.crooked = attitude_of(level, w.mocap_roll, w.mocap_pitch)
        self.z = z = np.zeros((n, 20))
        z[:, X], z[:, Q] = rows[0, :, :3], attitude_of(rows[0, :, control.REF_YAW], level, level)
        self.states, self.commands = np.zeros((ticks, n, 20)), np.zeros((ticks, n, 4))
        self.volts = np.zeros((ticks, n))
        self.seen = np.zeros((ticks, n, 6))  # poses as motion capture shows them, without noise
        # What the pilot believes of position and velocity.
        self.position, self.velocity = rows[0, :, :3].copy(), np.zeros((n, 3))
        self.angles = np.zeros((n, 3))
        self.build()

    def period(self, k: int) -> None:
        """Advance by a period of the flight controller."""
        c, w, z, time = self.reality.constants, self.w, self.z, k / RATE - WARM_UP
        self.states[k] = z
        estimate = product(z[:, Q], self.level)  # of the flight controller
        self._see(k, z, estimate)
        if k % 2 == 0:
            self._track(delayed(self.seen, k, w.mocap_delay) + self.noise[k], 2.0 / RATE)
        held, heard = RATE // PILOT_RATE, self.heard[k]
        self.commands[k] = self.commands[k - 1] if k % held else self._command(self.rows[k // held])
        pwm = delayed(self.commands, heard, w.thrust_delay)[:, 0]
        rest = received(delayed(self.commands, heard, w.attitude_delay), w)
        wanted = np.column_stack([c.thrust_per_pwm * pwm, *rest])
        supply, fade = self._supply(k, z, time), 1.0 - w.thrust_fade * max(time, 0.0)
        z[:, WIND] = wind_at(z[:, X], w) + self.gust[k]
        push = self.air[k].copy()
        push[:, :3] += external(z[:, Q], time, c, w)
        self.z = self.advance(estimate, wanted, supply, fade, push)

    def _see(self, k: int, z: np.ndarray, estimate: np.ndarray) -> None:
        """Fill row k of `seen`; its yaw is continuous."""
        seen = self.seen[k]
        seen[:, :3], seen[:, 3:] = z[:, X], angles_of(product(estimate, self.crooked))
        seen[:, 0] *= 1.0 + self.w.capture_scale * z[:, 0]
        seen[:, 5] += 2 * np.pi * np.round((self.seen[k - 1, :, 5] - seen[:, 5]) / (2 * np.pi))

    def _track(self, measured: np.ndarray, period: float) -> None:
        """Follow the measured poses (n, 6)."""
        self.position += self.velocity * period
        error = measured[:, :3] - self.position
        self.position += _FILTER[0] * error
        self.velocity += _FILTER[1] / period * error
        self.angles = measured[:, 3:]

    def _command(self, ref: np.ndarray) -> np.ndarray:
        """Return PWM, roll, pitch, yaw rate (n, 4) for one row of every reference (n, REF_SIZE)."""
        c, yaw = self.reality.constants, self.angles[:, 2]
        thrust, q, upward = self.wish(attitude_of(yaw, *self.angles[:, :2].T), ref)
        roll, pitch, _ = angles_of(q).T
        step = ref[:, control.REF_MODE] == control.STEP  # angles as given, thrust for the height
        roll = np.where(step, ref[:, control.REF_ROLL], roll)
        pitch = np.where(step, ref[:, control.REF_PITCH], pitch)
        upright = upward / (np.cos(roll) * np.cos(pitch))
        pwm = np.where(step, upright, thrust) / c.thrust_per_pwm + ref[:, control.REF_PWM]
        off = np.angle(np.exp(1j * (ref[:, control.REF_YAW] - yaw)))
        turn = ref[:, control.REF_YAW_RATE] + c.yaw_gain * off
        most = np.array([c.angle_limit, c.angle_limit, c.yaw_rate_limit])
        rest = np.clip(np.column_stack([roll, pitch, turn]), -most, most)
        return np.column_stack([np.clip(pwm, *c.pwm_range), rest])

    def _supply(self, k: int, z: np.ndarray, time: float) -> np.ndarray:
        """Return the rotor speed (n,) per commanded speed, under the battery's voltage, which is logged."""
        c, w = self.reality.constants, self.w
        load = c.hover_current / (c.mass * c.gravity) * self.thrusts(z[:, ROTORS]).sum(1)
        self.volts[k] = c.battery_voltage + w.battery_voltage - c.battery_fall * max(time, 0.0)
        self.volts[k] -= w.battery_resistance * load
        share = self.volts[k] / np.where(w.battery_reference > 0.0, w.battery_reference, self.volts[k])
        return share ** (0.5 * self.reality.build.battery_power)

    def recordings(self, rng) -> list[Recording]:
        """Return the logs."""
        c, b, w = self.reality.constants, self.reality.build, self.w
        every, first = round(b.log_ticks) // 2, round(WARM_UP * RATE)
        rows = np.arange(-(-first // every) * every, len(self.states), every)
        delay = w.mocap_delay + w.log_delay
        poses = np.array([delayed(self.seen, k, delay) for k in rows]) + self.noise[rows]
        flown = []
        for j in range(len(delay)):
            t, z = np.arange(len(rows)) * every / RATE, self.states[rows, j]
            late = b.stamp_jitter * rng.standard_normal(len(t))
            late = np.clip(late, -0.4 * every / RATE, 0.4 * every / RATE)
            rotors = self.thrusts(z[:, ROTORS])
            flown.append(
                Recording(
                    t=t + late - late[0],
                    position=poses[:, j, :3],
                    attitude=poses[:, j, 3:],
                    command=self.commands[rows, j],
                    voltage=self.volts[rows, j] + c.voltage_noise * rng.standard_normal(len(t)),
                    contact=np.zeros(len(t), bool),
                    truth=np.hstack([z[:, X], z[:, V], angles_of(z[:, Q]), z[:, W], rotors]),
                )
            )
        return flown

    def build(self) -> None:
        """Make the vehicles and spin their rotors for hover."""
        c, n = self.reality.constants, len(self.worlds)
        self.plant = vehicle([parameters(c, one) for one in self.worlds])
        self.coefficients = self.plant.params.k_eta.clone(), self.plant.params.k_m.clone()
        # The flight controller knows the nominal vehicle; its attitude gain may be another.
        believed = [parameters(c, World(attitude_time_scale=one.attitude_time_scale)) for one in self.worlds]
        self.loop = vehicle(believed, "cmd_ctatt")
        gains = np.array([c.position_gains, c.position_gains, c.height_gains])
        kp, kd = (torch.from_numpy(np.tile(gains[:, j], (n, 1))) for j in range(2))
        self.control = BatchedSE3Control(self.loop.params, n, _CPU, kp, kd)
        self.z[:, ROTORS] = math.sqrt(c.mass * c.gravity / (4 * c.thrust_per_speed))

    def gusts(self, rng, ticks: int) -> np.ndarray:
        """Return RotorPy's horizontal Dryden gusts (ticks, n, 3), of standard deviation `gust`."""
        w, n, seed = self.w, len(self.worlds), int(rng.integers(2**31))
        if not w.gust.any():
            return np.zeros((ticks, n, 3))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            # Its length at 1 m/s is eight times the altitude.
            still, altitude = torch.zeros(n, 3, dtype=torch.float64), torch.from_numpy(w.gust_time / 8.0)
            gusts_of = BatchedDrydenGust(1 / RATE, still, still + 1.0, altitude)
            path = np.array([gusts_of.update(0.0, None).numpy() for _ in range(ticks)]) * [1.0, 1.0, 0.0]
        return path / path[:, :, :2].std() * w.gust[:, None]

    def wish(self, q: np.ndarray, ref: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the pilot's thrust (n,) [N], attitude (n, 4) and upward force (n,) [N].

        q (n, 4) are attitudes, ref (n, REF_SIZE) one row of every reference.
        """
        yaw, still = self.angles[:, 2], np.zeros_like(self.position)
        state = {"x": self.position, "v": self.velocity, "q": q, "w": still}
        flat = {"x": ref[:, 0:3], "x_dot": ref[:, 3:6], "x_ddot": ref[:, 6:9], "yaw": yaw}
        done = self.control.update(0.0, _tensors(state), _tensors(flat | {"yaw_dot": 0.0 * yaw}))
        thrust, q, acceleration = (done[key].numpy() for key in ("cmd_thrust", "cmd_q", "cmd_acc"))
        return thrust[:, 0], q, self.reality.constants.mass * acceleration[:, 2]

    @torch.inference_mode()
    def advance(self, estimate, wanted, supply, fade, push) -> np.ndarray:
        """Return the state one period later.

        estimate (n, 4) is the controller's attitude; wanted (n, 4) the thrust [N], roll, pitch and yaw rate
        that it received; supply (n,) the rotor speed per speed asked for; fade (n,) the share of thrust that
        is left; push (n, 6) what adds to acceleration and angular acceleration.
        """
        z, (thrust, roll, pitch, yaw_rate) = self.z, wanted.T
        rates = z[:, W].copy()
        rates[:, 2] -= self.w.yaw_drift + yaw_rate  # the loop damps what is left
        asked = {"cmd_q": attitude_of(angles_of(estimate)[:, 2], roll, pitch)}
        asked["cmd_thrust"] = np.ascontiguousarray(thrust[:, None])
        state = _tensors({"q": estimate, "w": rates})
        speeds = self.loop.get_cmd_motor_speeds(state, _tensors(asked), torch.arange(len(z))).numpy()
        left = torch.from_numpy(fade)[:, None]
        self.plant.params.k_eta, self.plant.params.k_m = (left * one for one in self.coefficients)
        added = np.zeros_like(z)
        added[:, V], added[:, W] = push[:, :3], push[:, 3:]
        s, speeds, added = map(torch.from_numpy, (z, speeds * supply[:, None], added))
        return advance(self.plant, s, speeds, added, 1.0 / RATE).numpy()

    def thrusts(self, rotors: np.ndarray) -> np.ndarray:
        """Return the thrust [N] of rotors (..., 4) in still air."""
        return self.reality.constants.thrust_per_speed * rotors**2


def fly(
    paths: np.ndarray, worlds: Sequence[World], rng: np.random.Generator, reality: Reality
) -> list[Recording]:
    """Fly paths (k, n, REF_SIZE) at 50 Hz, one in each world, and return their logs."""
    rows = np.concatenate([np.repeat(paths[:1], round(WARM_UP * PILOT_RATE), axis=0), paths])
    batch = Flights(rows, worlds, rng, reality)
    for k in range(len(batch.states)):
        batch.period(k)
    return batch.recordings(rng)


def fly_groups(
    groups: Sequence[tuple[Drawn, int]], rng: np.random.Generator, reality: Reality, seconds: float = 20.0
) -> list[list[Recording]]:
    """Fly so many ordinary flights for every (cause, count), all in one batch; kinds in a random order.

    A flight that comes near the floor, or leaves the room, is flown again on another path.
    """
    todo = []  # kind, world, group
    for group, (drawn, count) in enumerate(groups):
        rounds = [rng.permutation(KINDS) for _ in range(-(-count // len(KINDS)))]
        for kind in np.concatenate(rounds)[:count] if count else ():
            todo.append((str(kind), drawn.world_of(rng), group))
    flown: dict[int, Recording] = {}
    for _ in range(_TRIES):
        left = [k for k in range(len(todo)) if k not in flown]
        if not left:
            return [[flown[k] for k in range(len(todo)) if todo[k][2] == g] for g in range(len(groups))]
        paths = [ordinary(todo[k][0], rng, seconds, LOWEST) for k in left]
        batch = fly(np.stack(paths, axis=1), [todo[k][1] for k in left], rng, reality)
        flown |= {k: one for k, one in zip(left, batch) if _stays(one)}
    raise RuntimeError(f"some flights of {reality.family} did not stay in the room")


def _stays(flight: Recording) -> bool:
    x = flight.truth[:, :3]
    return bool(np.isfinite(x).all() and x[:, 2].min() > _TOUCH and np.abs(x).max() < _FAR)


def _tensors(values: dict[str, np.ndarray]) -> dict:
    return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in values.items()}
