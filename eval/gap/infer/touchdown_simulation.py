"""Landings simulated in MuJoCo and compared with the measured motion after contact.

Every landing is simulated in the MuJoCo plant from the measured state shortly before contact, under the
commands that were sent, and the motion that follows is compared in the surface frame. Errors are whitened by
their covariance at each moment: noise of measurement and start state, and the difference between two
idealised contact models. So the resting pose counts little, and the tenth of a second after contact, in which
stiffness and damping differ, counts most.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap.measured.landings import BEFORE, TRANSIENT, Landing
from inclined_landing.eval.gap.model.columns import Candidates
from inclined_landing.eval.gap.model.prediction import delayed_commands, without_delays
from inclined_landing.models.attitude import LAG, PITCH, ROLL, X, Y, Z
from inclined_landing.models.effects import Effect
from inclined_landing.models.effects.touchdown import spring_of
from inclined_landing.models.vehicle import Vehicle

STEP = 0.00125  # s, largest step of the engine
MOST_DAMPING = 0.75 / STEP  # 1/s: with more the engine is unstable, and a vehicle seems to bounce


@dataclasses.dataclass(frozen=True)
class TouchdownProblem(Candidates):
    """Landings and candidate contact effects: a nonlinear regression problem.

    Channels: along and across the slope, along its normal, roll, pitch, yaw.
    """

    landings: tuple[Landing, ...]
    reach: float  # m, of the feet below the centre of mass
    samples: int  # compared of every landing

    @staticmethod
    def of(landings: Sequence[Landing], vehicle: Vehicle, library: Mapping[str, Effect]) -> TouchdownProblem:
        """Return the problem with the effects of contact of a library."""
        from inclined_landing.models.geometry import reach_below, shapes_of
        from inclined_landing.models.scene import compile_scene

        contact = {name: effect for name, effect in library.items() if effect.contact}
        reach = float(reach_below(shapes_of(compile_scene(vehicle)), part="feet"))
        samples = min(len(x.compared) for x in landings)
        return TouchdownProblem(vehicle, contact, tuple(landings), reach, samples)

    def errors(self, vehicle: Vehicle) -> np.ndarray:
        """Return the white errors (n, 6, samples), in standard deviations."""
        errors, q = self.deviations(vehicle), self.samples
        whiten = np.stack([x.whiten[:, :q, :q] for x in self.landings])
        return np.einsum("ncij,njc->nci", whiten, errors, optimize=True)

    def deviations(self, vehicle: Vehicle) -> np.ndarray:
        """Return measured minus simulated and expected pose (n, samples, 6), in the surface frame."""
        simulated = simulate(self.landings, vehicle)
        result = np.empty((len(self.landings), self.samples, 6))
        si, ci = math.sin(self.vehicle.platform_inclination), math.cos(self.vehicle.platform_inclination)
        # MuJoCo's contact has no static deflection: the difference to the nominal one is added, exponentially
        # settled after contact.
        lower, leaning = np.subtract(
            static_deflection(vehicle, self.reach), static_deflection(self.vehicle, self.reach)
        )
        for k, landing in enumerate(self.landings):
            error = (landing.measured - simulated[k][landing.compared])[: self.samples]
            if landing.on_platform:
                x, z = error[:, 0].copy(), error[:, 2].copy()
                error[:, 0], error[:, 2] = ci * x - si * z, si * x + ci * z
            t = landing.compared[: self.samples] * landing.dt - BEFORE
            settled = 1.0 - np.exp(-np.maximum(t, 0.0) / TRANSIENT)
            error[:, 2] += lower * settled
            if landing.on_platform:
                error[:, 4] -= leaning * settled
            result[k] = error - landing.expected[: self.samples]
        return result


def static_deflection(vehicle: Vehicle, reach: float) -> tuple[float, float]:
    """Return the static deflection of the feet under the weight [m], and the pitch on the slope by it [rad].

    reach: distance of the feet below the centre of mass [m]. MuJoCo's contact is a constraint on
    accelerations (see "solref" in its manual) and carries the weight without deflection; feet deflect, and
    more on the side towards which the friction below the centre of mass tilts the vehicle.
    """
    # With the stiffness k per mass and the feet at +-arm:  z = g / k,  pitch = g sin(alpha) reach / (k arm^2)
    stiffness, g = spring_of(vehicle)[0], vehicle.environment_gravity
    along = g * math.sin(vehicle.platform_inclination)
    return g / stiffness, along * reach / (stiffness * vehicle.rotor_arm**2)


def simulate(landings: Sequence[Landing], vehicle: Vehicle) -> np.ndarray:
    """Return the simulated pose (n, rows + 1, 6) of every landing, in the MuJoCo plant."""
    from inclined_landing.models.plants import MujocoPlant  # here, as most flights have no landing
    from inclined_landing.models.plants.recorder import fly

    dt = landings[0].dt
    rows = max(x.rows for x in landings)
    n = len(landings)
    state = np.stack([x.start for x in landings])
    commands = np.zeros((n, rows, 4))
    for k, x in enumerate(landings):
        driven, lag = delayed_commands(x.command, dt, vehicle)
        part = driven[x.first : x.first + rows]
        commands[k, : len(part)] = part
        commands[k, len(part) :] = part[-1]
        state[k, LAG] = lag[x.first]
    step = dt / math.ceil(dt / STEP - 1e-9)
    stiffness, damping = spring_of(vehicle)
    if damping > MOST_DAMPING:
        vehicle = vehicle.changed(contact_solref=(-stiffness, -MOST_DAMPING))
    plant = MujocoPlant(
        n,
        without_delays(vehicle),
        control_period=dt,
        timestep=step,
        integrator="implicitfast",
        torque_needs_motors=True,
    )
    plant.set_platform(np.arange(n), vehicle.platform_inclination)
    plant.reset(np.arange(n), state)
    pose = fly(plant, commands.swapaxes(0, 1))[..., [X, Y, Z, ROLL, PITCH, PITCH + 1]].swapaxes(0, 1)
    pose[..., 3:] = np.unwrap(pose[..., 3:], axis=1)
    return pose
