"""RotorPy's Crazyflie as a reality: its equations of motion, its mixer and its controllers, not ours.

All flights of a case are one batch of `rotorpy.vehicles.multirotor.BatchedMultirotor`, integrated by the
midpoint rule. The pilot is RotorPy's SE3 controller (50 Hz, on the measured state): its thrust and
orientation are the logged PWM, roll and pitch. The vehicle turns what it receives into rotor speeds with
RotorPy's `cmd_ctatt` loop (250 Hz). Where RotorPy has a parameter for a hidden cause (mass, coefficients of
thrust, drag and lift, motor lag, gain of the attitude loop, wind), that parameter differs; the rest is
added at the interface (`interface.py`).

RotorPy is a package of its own (MIT license): pip install 'inclined-landing[baselines]'.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from inclined_landing.models.errors import optional
from tests.proof.simulator import Constants, Reality, World, constants

from . import interface
from .batch import ROTORS, Batch, Q, V, W, draw_reality
from .interface import RATE

with optional():
    import roma  # noqa: F401 (RotorPy's batch needs it)
    import torch
    import torchdiffeq  # noqa: F401
    from rotorpy.controllers.quadrotor_control import BatchedSE3Control
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams
    from rotorpy.wind.dryden_winds import BatchedDrydenGust

_CPU = torch.device("cpu")
_POSITION_GAINS, _HEIGHT_GAINS = (6.5, 4.0, 0.0), (15.0, 9.0, 0.0)  # RotorPy's kp_pos, kd_pos; no integral


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
    return draw_reality(rng, own, "rotorpy")


def flies(reality: Reality, w: World) -> bool:
    """Is the attitude loop well inside stability?

    With gains kp on the angle and kd on the rate, and motors of first order, tau: by Routh tau kp < kd.
    """
    p = parameters(reality.constants, w)
    return p["tau_m"] * p["kp_att"] < 0.7 * p["kd_att"]


def parameters(c: Constants, w: World | None = None) -> dict:
    """RotorPy's parameters of the vehicle of `c`: nominal, as its controllers believe, or in world `w`."""
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
    """RotorPy's batch of vehicles with these parameters."""
    n = len(params)
    batch = BatchedMultirotorParams(list(params), n, _CPU)
    return BatchedMultirotor(batch, n, {"x": torch.zeros(n, 3)}, _CPU, abstraction)


def advance(plant: BatchedMultirotor, s, speeds, push, h: float):
    """RotorPy's state (n, 20) after h seconds at commanded rotor speeds (n, 4); push (n, 20) adds to its
    derivative."""
    every = torch.arange(len(s))
    speeds = torch.clip(speeds, plant.params.rotor_speed_min, plant.params.rotor_speed_max)
    middle = s + 0.5 * h * (plant._s_dot_fn(0.0, s, speeds, every) + push)
    s = s + h * (plant._s_dot_fn(0.0, middle, speeds, every) + push)
    s[:, Q] /= torch.linalg.norm(s[:, Q], dim=1, keepdim=True)
    return s


class Flights(Batch):
    """Flights of RotorPy's vehicle, whose rotors' states are their speeds [rad/s]."""

    def build(self) -> None:
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
        """RotorPy's horizontal Dryden gusts (ticks, n, 3), of standard deviation `gust` over the flights."""
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
        yaw, still = self.angles[:, 2], np.zeros_like(self.position)
        state = {"x": self.position, "v": self.velocity, "q": q, "w": still}
        flat = {"x": ref[:, 0:3], "x_dot": ref[:, 3:6], "x_ddot": ref[:, 6:9], "yaw": yaw}
        done = self.control.update(0.0, _tensors(state), _tensors(flat | {"yaw_dot": 0.0 * yaw}))
        thrust, q, acceleration = (done[key].numpy() for key in ("cmd_thrust", "cmd_q", "cmd_acc"))
        return thrust[:, 0], q, self.reality.constants.mass * acceleration[:, 2]

    @torch.inference_mode()
    def advance(self, estimate, wanted, supply, fade, push) -> np.ndarray:
        z, (thrust, roll, pitch, yaw_rate) = self.z, wanted.T
        rates = z[:, W].copy()
        rates[:, 2] -= self.w.yaw_drift + yaw_rate  # the loop damps what is left
        asked = {"cmd_q": interface.turn(interface.angles(estimate)[:, 2], roll, pitch)}
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
        return self.reality.constants.thrust_per_speed * rotors**2


def _tensors(values: dict[str, np.ndarray]) -> dict:
    return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in values.items()}
