"""Crazyflow's Crazyflies as a reality: its identified dynamics and its onboard controllers, not ours.

A case draws one of four vehicles and one of four dynamics. With `first_principles` the commands go through
Crazyflow's Mellinger attitude controller (500 Hz) to four rotors; in `so_rpy`, `so_rpy_rotor` and
`so_rpy_rotor_drag` the closed attitude loop itself was identified, of second order and with a gain below 1.
The pilot is its Mellinger position controller (50 Hz, on the measured state). A flight takes Crazyflow's
symplectic Euler steps. Where a model has a parameter for a hidden cause (mass, thrust, drag, motor lag, gains
of the attitude loop), that parameter differs; wind is the velocity that drag sees; the rest is added at the
interface (`interface.py`).

Crazyflow is a package of its own (MIT license): pip install 'inclined-landing[baselines]'.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
from unittest import mock

import numpy as np
from scipy.spatial.transform import Rotation

from inclined_landing.models.errors import optional
from tests.proof.simulator import Reality, World, control

from . import interface
from .batch import ROTORS, WIND, Batch, Q, V, W, X, draw_reality
from .interface import RATE

# Crazyflow asks for SciPy's array API, which NumPy's arrays do without; MJX prints what it does without.
_ASKED = mock.patch.dict(os.environ, SCIPY_ARRAY_API="1")
with optional(), _ASKED, contextlib.redirect_stdout(None):
    from crazyflow.control import load_fn_params as law_params
    from crazyflow.control.mellinger import attitude2force_torque, force_torque2rotor_vel, state2attitude
    from crazyflow.control.transform import motor_force2rotor_vel
    from crazyflow.dynamics import available_dynamics, dynamics_features, load_fn_params

PHYSICAL = "first_principles"
VEHICLES = ("cf2x_L250", "cf2x_P250", "cf2x_T350", "cf21B_500")
FACTORS = ("mass", "inertia", "thrust", "drag", "motor", "stiffness", "damping")
# Gains of the pilot, across and upward, as shares of the firmware's, which asks for a velocity without lag.
_GAINS = {"kp": (0.5, 0.35), "kd": (0.75, 0.5), "ki": (1.0, 1.0)}
_PILOT_LAG = 0.07  # s, of its filter and of commands that stand for 20 ms
_STEPS = 2  # of Crazyflow's 500 Hz in a period


@dataclasses.dataclass(frozen=True)
class CrazyflowReality(Reality):
    """A vehicle of Crazyflow with parameters up to 10 % off: their factors by name."""

    drone: str = VEHICLES[0]
    factors: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def dynamics(self) -> str:
        return self.family.partition(" ")[2]


def draw(rng: np.random.Generator) -> CrazyflowReality:
    """Draw a reality: dynamics, vehicle, its air and its log."""
    model, drone = str(rng.choice(list(available_dynamics))), str(rng.choice(VEHICLES))
    factors = {name: rng.uniform(0.9, 1.1) for name in FACTORS}
    pilot = law_params(state2attitude, drone)
    across, upward = (
        tuple(pilot[name][2 * up] * share[up] * rng.uniform(0.9, 1.1) for name, share in _GAINS.items())
        for up in (0, 1)
    )
    own = {
        "mass": _loaded(load_fn_params, available_dynamics[model], drone)["mass"] * factors["mass"],
        "thrust_per_pwm": 4 * pilot["thrust_max"] / pilot["pwm_max"] * rng.uniform(0.9, 1.1),
        "position_gains": across,
        "height_gains": upward,
    }
    one = draw_reality(rng, own, f"crazyflow {model}")
    return CrazyflowReality(one.constants, one.build, one.family, drone, factors)


def flies(reality: CrazyflowReality, w: World) -> bool:
    """Are the loops of height and attitude well inside stability, by Routh, with motors of first order?

    With gains kp and kd, tau kp < kd. In the attitude loop they are torques per angle and rate over the
    inertia, beside ka per acceleration: tau kp < (1 + ka) kd.
    """
    p, kp, kd = parameters(reality, w), *reality.constants.height_gains[:2]
    if "rotor_dyn_coef" in p:
        hover = motor_force2rotor_vel(p["mass"] * 9.81 / 4, p["rpm2thrust"])[0]
        up, up2, down, down2 = p["rotor_dyn_coef"][0]
        tau = 1.0 / min(up + 2 * up2 * hover, down + 2 * down2 * hover)
    else:
        tau = 1.0 / p["thrust_dyn_coef"][0] if "thrust_dyn_coef" in p else 0.0
    height = bool((tau + _PILOT_LAG) * kp < 0.45 * kd)
    if not height or reality.dynamics != PHYSICAL:
        return height
    law = _loaded(law_params, attitude2force_torque, reality.drone)
    per_pwm = 2.0 * law["L"] * law["thrust_max"] / law["pwm_max"] / p["J"][0, 0]  # of two by two rotors
    kp, kd, ka = (per_pwm * law[name][0] for name in ("kR", "kw", "kd_omega"))
    kp *= 2.0 / w.attitude_time_scale  # its error is twice the angle
    return bool(tau * kp < 0.7 * (1.0 + ka) * kd)


@functools.cache
def _loaded(load, function, drone: str) -> dict:
    return load(function, drone)


def parameters(reality: CrazyflowReality, w: World | None = None) -> dict[str, np.ndarray]:
    """Crazyflow's parameters of the vehicle in world `w`: vectors, and a row for each rotor."""
    w, f = World() if w is None else w, reality.factors
    p = _loaded(load_fn_params, available_dynamics[reality.dynamics], reality.drone)
    p = {name: np.array(value, float) for name, value in p.items()}
    lag, scale = f["motor"] * w.motor_time_scale, f["thrust"] * w.thrust_scale
    across = np.array([w.lateral_drag, w.lateral_drag, 1.0])
    factors = {
        "mass": f["mass"] * w.mass_scale,
        "J": f["inertia"],
        "J_inv": 1.0 / f["inertia"],
        "drag_matrix": f["drag"] * w.drag_scale * across,
        "rpm2thrust": scale,
        "rpm2torque": scale,
        "rotor_dyn_coef": np.array([1.0, 1.0, *[1.0 / (1.0 + w.spin_down)] * 2]) / lag,
        "cmd_f_coef": scale,
        "thrust_dyn_coef": 1.0 / lag,
        "rpy_coef": f["stiffness"] / w.attitude_time_scale,
        "cmd_rpy_coef": f["stiffness"] / w.attitude_time_scale,
        "rpy_rates_coef": f["damping"],
    }
    p |= {name: p[name] * factor for name, factor in factors.items() if name in p}
    per_rotor = ("rpm2thrust", "rpm2torque", "rotor_dyn_coef")
    return {name: value[None] if value.ndim == 0 or name in per_rotor else value for name, value in p.items()}


class Flights(Batch):
    """Flights of Crazyflow's vehicle, whose rotors' states are RPM or, in `so_rpy*`, the thrust command [N]
    of the whole vehicle that is in effect, in each of the four."""

    def build(self) -> None:
        r, n = self.reality, len(self.worlds)
        self.physical, self.equations = r.dynamics == PHYSICAL, available_dynamics[r.dynamics]
        self.lags = dynamics_features(self.equations)["rotor_dynamics"]
        every = [parameters(r, one) for one in self.worlds]
        self.p = {name: np.stack([one[name] for one in every]) for name in every[0]}
        self.nominal = parameters(r)
        self.law, self.mixer, self.pilot = (
            law_params(one, r.drone)
            for one in (attitude2force_torque, force_torque2rotor_vel, state2attitude)
        )
        self.law["kR"] = self.law["kR"] / self.w.attitude_time_scale[:, None]
        c = r.constants
        gains = zip(_GAINS, zip(c.position_gains, c.position_gains, c.height_gains))
        self.pilot |= {name: np.array(values) for name, values in gains} | {"mass": c.mass}
        # The pilot's own scale of thrust against PWM is that of the log.
        self.pilot["mass_thrust"] = self.pilot["pwm_max"] / (4 * self.pilot["thrust_max"])
        self.off, self.twist, self.rates = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        self.heading = self.rows[0, :, control.REF_YAW].copy()  # that the vehicle holds
        self.z[:, ROTORS] = weight = c.mass * c.gravity
        if self.physical:
            self.z[:, ROTORS] = motor_force2rotor_vel(np.full(4, weight / 4), self.nominal["rpm2thrust"])

    def wish(self, q: np.ndarray, ref: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        level = np.zeros(len(q))
        cmd = np.hstack(
            [ref[:, :9], interface.turn(self.angles[:, 2], level, level), np.zeros_like(ref[:, :3])]
        )
        done, self.off = state2attitude(self.position, q, self.velocity, cmd, self.off, 50, **self.pilot)
        wanted = Rotation.from_euler("xyz", done[:, :3])
        axis = wanted.apply([0.0, 0.0, 1.0])
        along = (axis * Rotation.from_quat(q).apply([0.0, 0.0, 1.0])).sum(1)
        return done[:, 3], wanted.as_quat(), done[:, 3] / along * axis[:, 2]

    def advance(self, estimate, wanted, supply, fade, push) -> np.ndarray:
        z, w, (thrust, roll, pitch, yaw_rate) = self.z.copy(), self.w, wanted.T
        self.heading += (yaw_rate + w.yaw_drift) / RATE
        asked = Rotation.from_quat(interface.turn(self.heading, roll, pitch))
        asked *= Rotation.from_quat(self.level).inv()  # in truth, when its estimate is as asked
        p = self.p | {
            name: self.p[name] * fade.reshape(-1, *[1] * (self.p[name].ndim - 1))
            for name in ("rpm2thrust", "rpm2torque", "cmd_f_coef")
            if name in self.p
        }
        cmd, loop = (
            np.column_stack([asked.as_euler("xyz"), thrust]),
            self._rotors if self.physical else self._loop,
        )
        for _ in range(_STEPS):
            self._step(z, loop(z, cmd, supply**2), p, push, 1.0 / (RATE * _STEPS))
        return z

    def _rotors(self, z: np.ndarray, cmd: np.ndarray, supply: np.ndarray) -> np.ndarray:
        """RPM that Crazyflow's attitude controller asks for, with a share `supply` of its thrust."""
        force, torque, self.twist = attitude2force_torque(
            z[:, Q], z[:, W], cmd, self.rates, self.twist, RATE * _STEPS, **self.law
        )
        self.rates = z[:, W].copy()
        asked = self.thrusts(force_torque2rotor_vel(force, torque, **self.mixer))
        return motor_force2rotor_vel(supply[:, None] * asked, self.nominal["rpm2thrust"])

    def _loop(self, z: np.ndarray, cmd: np.ndarray, supply: np.ndarray) -> np.ndarray:
        """The command of an identified loop; its heading, near the present one, with a gain of 1."""
        yaw = Rotation.from_quat(z[:, Q]).as_euler("xyz")[:, 2]
        near = yaw + np.angle(np.exp(1j * (cmd[:, 2] - yaw)))
        return np.column_stack(
            [cmd[:, :2], -near * self.p["rpy_coef"][:, 2] / self.p["cmd_rpy_coef"][:, 2], supply * cmd[:, 3]]
        )

    def _step(self, z: np.ndarray, cmd: np.ndarray, p: dict, push: np.ndarray, h: float) -> None:
        """Advance state z by h seconds."""
        w, mass, turned = self.w, p["mass"], Rotation.from_quat(z[:, Q])
        air = z[:, V] - z[:, WIND]
        ahead = turned.apply(air, inverse=True)
        force = self.thrusts(z[:, ROTORS], p).sum(1)
        inflow = (1.0 + w.translational_lift * (ahead[:, :2] ** 2).sum(1)) * (
            1.0 - w.axial_inflow * ahead[:, 2]
        )
        outside = mass * push[:, :3] - (w.body_drag * np.linalg.norm(air, axis=1))[:, None] * air
        outside += turned.apply([0.0, 0.0, 1.0]) * (force * (inflow - 1.0))[:, None]
        arm = np.column_stack([w.com_y, -w.com_x, np.zeros_like(w.com_x)])
        torque = arm * force[:, None] + (p["J"] @ push[:, 3:, None])[..., 0]
        p = p | {"rotor_vel": z[:, ROTORS]} if self.lags else p
        pushed = {"dist_f": outside, "dist_t": turned.apply(torque)}
        done = self.equations(z[:, X], z[:, Q], air, z[:, W], cmd, **pushed, **p)
        z[:, V] += h * done[2]
        z[:, W] += h * done[3]
        z[:, ROTORS] = z[:, ROTORS] + h * done[4] if self.lags else cmd[:, 3:]
        z[:, X] += h * z[:, V]
        z[:, Q] = (turned * Rotation.from_rotvec(h * z[:, W])).as_quat()

    def thrusts(self, rotors: np.ndarray, p: dict | None = None) -> np.ndarray:
        if not self.physical:
            share = self.nominal["cmd_f_coef"] if p is None else p["cmd_f_coef"]
            return share * rotors / 4
        k = (self.nominal if p is None else p)["rpm2thrust"]
        return k[..., 0] + k[..., 1] * rotors + k[..., 2] * rotors**2
