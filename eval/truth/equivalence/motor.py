"""The paper's discrete motor function at 500 Hz against the continuous lag of the model.

F[k] = pole F[k-1] + gain u[k] is, sample by sample, the continuous lag under a command held between
samples, with a = -ln(pole) / T, direct gain = gain, state gain = gain pole a / (1 - pole).
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from importlib import resources

import mujoco
import numpy as np

from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.truth.equivalence.flying import WORDS, engine
from inclined_landing.models.vehicle import Vehicle

SAMPLES = 500  # one second
HOLD = 5  # samples between new commands


def quoted(section: str, name: str) -> float:
    """Return a number of the paper or its code, from `paper.toml`."""
    text = resources.files(__package__).joinpath("paper.toml").read_text("utf-8")
    return float(tomllib.loads(text)[section][name]["value"])


def exact(v: Vehicle) -> Vehicle:
    """Return the vehicle with the exact continuous coefficients of the discrete function, not rounded."""
    gain, pole = v.motor_count * quoted("motor_function", "gain"), quoted("motor_function", "pole")
    # F[k] = p F[k-1] + g u[k]:  a = -ln(p) / T,  direct gain g,  state gain g p a / (1 - p)
    rate = -math.log(pole) * quoted("motor_function", "rate")
    return dataclasses.replace(
        v,
        thrust_lag_rate=rate,
        thrust_direct_gain=gain,
        thrust_state_gain=gain * pole * rate / (1 - pole),
    )


def commands(v: Vehicle, seed: int) -> np.ndarray:
    """Return (SAMPLES,) PWM over the full range, new ones every HOLD samples."""
    draws = np.random.default_rng([seed, 30]).uniform(*v.command_pwm_range, SAMPLES // HOLD)
    return np.repeat(draws, HOLD)


def discrete(v: Vehicle, pwm: np.ndarray) -> np.ndarray:
    """Return (k,) thrust [N] of four discrete motors from rest."""
    gain, pole = v.motor_count * quoted("motor_function", "gain"), quoted("motor_function", "pole")
    thrust, force = np.empty(len(pwm)), 0.0
    for k, u in enumerate(pwm):
        force = pole * force + gain * u
        thrust[k] = force
    return thrust


def continuous(v: Vehicle, pwm: np.ndarray, integrator: str) -> np.ndarray:
    """Return (k,) thrust [N] of the engine's actuator from rest, one command per time step of 2 ms."""
    period = 1 / quoted("motor_function", "rate")
    model = engine(1, "kinematic", v, integrator=integrator, timestep=period).model
    data = mujoco.MjData(model)
    data.qpos[2], data.mocap_pos[:, 2] = 50.0, -100.0
    data.act[0] = 0.0
    actuator = model.actuator("thrust").id
    thrust = np.empty(len(pwm))
    for k, u in enumerate(pwm):
        data.ctrl[0] = u
        mujoco.mj_forward(model, data)
        thrust[k] = data.actuator_force[actuator]
        mujoco.mj_step(model, data)
    return thrust


def section(v: Vehicle, seed: int) -> Section:
    """Return the section of the report."""
    pwm = commands(v, seed)
    expected = discrete(v, pwm)
    full = v.thrust_per_pwm * v.command_pwm_range[1]
    unrounded = exact(v)
    errors = {
        name: np.abs(continuous(unrounded, pwm, name) - expected).max() / full for name in ("RK4", "Euler")
    }
    rows = []
    for name in ("thrust_lag_rate", "thrust_state_gain", "thrust_direct_gain"):
        exactly, rounded_to = getattr(unrounded, name), getattr(v, name)
        rows.append((name, f"{exactly:.7g}", f"{rounded_to:.7g}", rounded_to / exactly - 1))
    measured = {
        "exact": errors["Euler"],
        "rk4": errors["RK4"],
        "rounded": np.abs(continuous(v, pwm, "RK4") - expected).max() / full,
    }
    heads = ("coefficient", "exact", "vehicle file", "relative difference")
    return WORDS.section("motor", measured, tables=[Table("Coefficients", heads, rows)])
