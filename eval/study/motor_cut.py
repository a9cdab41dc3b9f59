"""Comparison of a policy that stops its motors and comes to rest with cutting the motors of another one.

From every start of the frozen grid, at each friction and restitution, two vehicles fly in the MuJoCo plant
(RK4, 4 ms):

- `cut in goal box`: a landing policy; the evaluation cuts its motors when it enters the goal box, as in the
  paper. It has 300 control steps to get there and 2 s more to come to rest;
- `touchdown policy`: idles the motors itself, within 300 control steps.

Both are evaluated by the rule of the touchdown task: 0.3 s at rest on the feet; the floor ends a flight. A
vehicle under PWM 0 has no attitude torque. Speeds are those of the centre of mass before any part first meets
the slab; the peak normal force is that on the feet at any engine step. Where friction cannot hold the slope,
mu <= tan(inclination), no vehicle can come to rest; such conditions are listed but not counted.

If effects are given, both also fly vehicles with one effect of the library at its plausible size, with which
the policies were not trained, and with the contact parameters of the vehicle file.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd

from inclined_landing.envs.mission import slope_normal
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.measures import alone, count_words, median_of, share_of
from inclined_landing.envs.tasks import frozen, hover_states
from inclined_landing.envs.tasks.touchdown import CONTACT_TIME, HOLD_STEPS, InclinedTouchdown
from inclined_landing.eval.study import changes
from inclined_landing.eval.study.engine import Case, Panel, Results, Study, View, fact
from inclined_landing.eval.study.flights import policy_facts
from inclined_landing.eval.study.options import FRICTIONS, RESTITUTIONS
from inclined_landing.eval.study.rest import TOUCH, PolicyPilot, fly_to_rest
from inclined_landing.models.attitude import LAG
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP
from inclined_landing.models.vehicle import Vehicle

SETTLING = 100  # control steps that the motor cut has after the goal box
CUT, OWN = "cut in goal box", "touchdown policy"
AT_REST = share_of("at_rest", "at rest", said="came to rest on its feet")
_NOTE = "speeds at the first touch, peak normal force on the feet"
MEASURES = (AT_REST, *TOUCH, median_of("peak_normal_force", "peak force", "N", cell=alone, note=_NOTE))


def land(
    policy: Policy,
    states: np.ndarray,
    friction: float | None = None,
    restitution: float | None = None,
    vehicle: Vehicle | None = None,
) -> pd.DataFrame:
    """Return a row for each flight from `states` (n, 13), as `fly_to_rest` does.

    The motors of a landing policy are cut in the goal box. friction and restitution: both None for those of
    the vehicle. vehicle: the vehicle that flies, if it is not the policy's; it begins with the same load.
    """
    task, n = policy.task, len(states)
    vehicle = task.vehicle if vehicle is None else vehicle
    tilt = vehicle.platform_inclination - task.vehicle.platform_inclination
    states = states.copy()
    states[:, LAG] *= task.vehicle.thrust_lag_rate / vehicle.thrust_lag_rate
    plant = MujocoPlant(n, vehicle, timestep=STEP, torque_needs_motors=True)
    plant.set_platform(np.arange(n), task.inclination + tilt, azimuth=task.azimuth)
    if friction is not None:
        plant.set_contact(np.arange(n), friction=friction, restitution=restitution, contact_time=CONTACT_TIME)
    pilot = PolicyPilot(policy, n)
    settling = SETTLING if task.cut_at_success else None
    return fly_to_rest(plant, states, pilot, steps=task.max_steps, hold=HOLD_STEPS, after_cut=settling)


def study(
    policy: Policy,
    baseline: Policy,
    *,
    frictions: Sequence[float] = FRICTIONS,
    restitutions: Sequence[float] = RESTITUTIONS,
    effects: Sequence[str] = (),
) -> Study:
    """Return the study of a touchdown policy and the motor cut; effects: of the library."""
    _check(policy, baseline)
    task = policy.task
    states = hover_states(frozen.clear(task, frozen.grid()), task.vehicle)
    slip, angle = math.tan(abs(task.inclination)), math.degrees(abs(task.inclination))
    pairs = itertools.product(sorted({mu for mu in frictions if mu > slip}), sorted(set(restitutions)))
    cases = []
    for (mu, e), (motors, pilot) in itertools.product(pairs, ((CUT, baseline), (OWN, policy))):
        labels = {"motors": motors, "friction": float(mu), "restitution": float(e), "contact": "all"}
        cases.append(Case(labels, partial(land, pilot, states, mu, e)))
    of_effects = [c for c in changes.changes((), effects, ("medium",)) if c.size]
    for change, (motors, pilot) in itertools.product(of_effects, ((CUT, baseline), (OWN, policy))):
        labels = {"motors": motors, "effect": change.effect.name}
        cases.append(Case(labels, partial(land, pilot, states, vehicle=change.vehicle(task.vehicle))))
    if not cases:
        raise UserError(f"friction must exceed {slip:.2f}, the tangent of the slope, for a vehicle to rest")
    weight = task.vehicle.body_mass * task.vehicle.environment_gravity
    return Study(
        name="touchdown",
        title=f"At rest on a slope of {angle:.1f} deg, {len(states)} starts per condition",
        series="motors",
        cases=cases,
        views=[
            *(View((label, "motors"), MEASURES, f"by {label}") for label in ("friction", "restitution")),
            View(("contact", "motors"), MEASURES, "friction and restitution together"),
            View(("effect", "motors"), MEASURES, "effects"),
            View(("friction", "restitution", "motors"), MEASURES),
        ],
        panels=[
            Panel("", AT_REST, "friction", "friction", where={"restitution": None}),
            Panel("", AT_REST, "restitution", "restitution", where={"friction": None}),
            Panel("Effects", AT_REST, "effect"),
        ],
        remarks=partial(_remarks, [mu for mu in sorted(set(frictions)) if mu <= slip], angle),
        facts=[
            *policy_facts({OWN: policy, CUT: baseline}),
            fact("vehicle", "weight", weight, "N"),
            *(row for change in of_effects for row in change.facts),
        ],
    )


def _check(policy: Policy, baseline: Policy) -> None:
    """Raise UserError unless one touches down and the other lands, on the same slope."""
    if not isinstance(policy.task, InclinedTouchdown):
        raise UserError(f"policy {policy.path} is for the task {policy.task.name}, not for touchdown")
    if not baseline.task.cut_at_success:
        raise UserError(f"the baseline {baseline.path} is for the task {baseline.task.name}, not for landing")
    if not np.allclose(slope_normal(policy.task), slope_normal(baseline.task), atol=1e-6):
        raise UserError("the touchdown policy and the baseline are for different slopes")


def _remarks(cannot_hold: Sequence[float], angle: float, results: Results) -> list[str]:
    """Return sentences on the share of vehicles at rest, and on frictions that are not counted."""
    said = []
    for motors in (OWN, CUT):
        rows = results.all(AT_REST, motors=motors, contact="all") or results.all(AT_REST, motors=motors)
        where = "" if rows[0]["contact"] else f" with {rows[0]['effect']}"
        said.append(f"{motors.capitalize()}: {AT_REST.said} in {count_words(rows[0])}{where}.")
    return said + [
        f"Not counted: friction {mu:g}, which is below tan({angle:.1f} deg) and cannot hold the vehicle."
        for mu in cannot_hold
    ]
