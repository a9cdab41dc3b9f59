"""`landing-eval touchdown`: rest on the slope by the policy's own command, compared with cutting the motors.

From every start of the frozen grid, at each friction and restitution, two vehicles fly in the MuJoCo plant
(RK4, 4 ms):

- `motor_cut`: a landing policy; at its entry into the goal box the motors are cut from outside, as in the
  paper. It has 300 control steps to get there and 2 s more to come to rest;
- `touchdown`: a touchdown policy, which idles the motors itself, within 300 control steps.

Both are evaluated by the rule of the touchdown task: 0.3 s at rest on the feet; the floor ends a flight. A
vehicle under PWM 0 has no attitude torque. Speeds are those of the centre of mass before any part first meets
the slab; the peak normal force is that on the feet at any engine step. Where friction cannot hold the slope,
mu <= tan(inclination), no vehicle can come to rest; such conditions are listed but not counted.

With ``--effect`` both also fly vehicles with one effect of the library at a plausible size, which the
policies were not trained with, on the contact of the vehicle file.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
import tyro

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.mission import slope_normal
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.envs.shared.tables import count_words
from inclined_landing.envs.tasks.touchdown import CONTACT_TIME, HOLD_STEPS, InclinedTouchdown
from inclined_landing.eval.base.claims import Section, show_sections
from inclined_landing.eval.base.options import Flag, NewFolder, PolicyFile, PolicyName, VehicleFile
from inclined_landing.eval.policies.changes import check_effects, sizes
from inclined_landing.eval.policies.flying import summary
from inclined_landing.eval.policies.rest import PolicyPilot, fly_to_rest
from inclined_landing.eval.policies.study import csv, fly_all, joined
from inclined_landing.eval.policies.tables import outcomes_table
from inclined_landing.models import contact
from inclined_landing.models.attitude import LAG
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP
from inclined_landing.models.vehicle import Vehicle

FRICTIONS = (0.5, 0.6, 0.8, 1.2)
RESTITUTIONS = (0.0, 0.25, 0.5)
SETTLING = 100  # control steps that the motor cut has after the goal box
MODES = {"motor_cut": "cut in goal box", "touchdown": "touchdown policy"}
BASELINE = "landing-nominal"  # whose motors are cut
_COUNTED = ("at_rest", "normal_speed", "tangential_speed", "peak_normal_force", "time")


def land(
    policy: Policy,
    states: np.ndarray,
    friction: float | None = None,
    restitution: float | None = None,
    vehicle: Vehicle | None = None,
) -> pd.DataFrame:
    """Return a row for each flight from `states` (n, 13), as `fly_to_rest` does.

    A landing policy gets its motors cut in the goal box. friction and restitution: None, both, for those of
    the vehicle. vehicle: the one that flies, where it is not the policy's; it begins with the same load.
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


def evaluate(
    policy: Policy,
    baseline: Policy,
    *,
    frictions: Sequence[float] = FRICTIONS,
    restitutions: Sequence[float] = RESTITUTIONS,
    effects: Sequence[str] = (),
) -> tuple[dict[str, Any], pd.DataFrame]:
    """Return the comparison as plain numbers, and all flights.

    effects: effects of the library, one entry of `effects` for each.
    """
    if not isinstance(policy.task, InclinedTouchdown):
        raise UserError(f"policy {policy.path} is for the task {policy.task.name}, not for touchdown")
    if not baseline.task.cut_at_success:
        raise UserError(f"the baseline {baseline.path} is for the task {baseline.task.name}, not for landing")
    if not np.allclose(slope_normal(policy.task), slope_normal(baseline.task), atol=1e-6):
        raise UserError("the touchdown policy and the baseline are for different slopes")
    task = policy.task
    starts = landing_starts.clear(task, landing_starts.grid())
    states = landing_starts.at_rest(task, starts)
    slip = math.tan(abs(task.inclination))
    gripping = sorted({mu for mu in frictions if mu > slip})
    work, pairs = {}, list(itertools.product(gripping, sorted(set(restitutions))))
    for mode, pilot in zip(MODES, (baseline, policy)):
        for mu, e in pairs:
            work[mode, f"friction {mu:g}, restitution {e:g}"] = partial(land, pilot, states, mu, e)
        for name in effects:
            vehicle = LIBRARY[name].apply(task.vehicle, LIBRARY[name].plausible)
            work[mode, name] = partial(land, pilot, states, vehicle=vehicle)
    flown = fly_all(work)

    def both(names: Sequence[str]) -> dict[str, Any]:
        return {mode: summary(pd.concat([flown[mode, name] for name in names]), *_COUNTED) for mode in MODES}

    def of(pairs: Sequence[tuple[float, float]]) -> list[str]:
        return [f"friction {mu:g}, restitution {e:g}" for mu, e in pairs]

    report = {
        "command": "touchdown",
        "policy": str(policy.path),
        "baseline": str(baseline.path),
        "trained": policy.metadata,
        "inclination": task.inclination,
        "starts": len(states),
        "weight": task.vehicle.body_mass * task.vehicle.environment_gravity,
        "cannot_hold": sorted({float(mu) for mu in frictions if mu <= slip}),
        "all": both(of(pairs)) if pairs else None,
        "friction": [{"friction": mu} | both(of([p for p in pairs if p[0] == mu])) for mu in gripping],
        "restitution": [
            {"restitution": e} | both(of([p for p in pairs if p[1] == e]))
            for e in (sorted(set(restitutions)) if pairs else ())
        ],
        "conditions": [{"friction": mu, "restitution": e} | both(of([(mu, e)])) for mu, e in pairs],
        "effects": [
            {"effect": name, "parameters": sizes(LIBRARY[name], LIBRARY[name].plausible)} | both([name])
            for name in effects
        ],
        "versions": runs.versions(),
    }
    return report, joined(flown)


def command(
    policy: PolicyFile,
    /,
    *,
    baseline: PolicyName = BASELINE,
    vehicle: VehicleFile = None,
    friction: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MU [MU ...]")] = FRICTIONS,
    restitution: Annotated[tuple[float, ...], tyro.conf.arg(metavar="E [E ...]")] = RESTITUTIONS,
    effect: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]")] = (),
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Compare a touchdown policy with a landing policy whose motors are cut (minutes).

    Args:
        policy: touchdown policy file, or name of a shipped one (touchdown).
        baseline: landing policy file, or name of a shipped one; landing-nominal is the paper's.
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
        friction: friction coefficients between feet and slope.
        restitution: coefficients of restitution of the feet on the slope, 0 to 0.6.
        effect: effects of the library, at a plausible size, that the policies were not trained with (default:
            none).
        json: print only JSON on standard output.
        out: new folder for touchdown.json and flights.csv.
    """
    if not (friction and restitution):
        raise UserError("give at least one --friction and one --restitution")
    contact.check_friction(friction)
    contact.check_restitution(restitution)
    check_effects(effect)
    flown = load_vehicle(vehicle) if vehicle is not None else None
    report, flights = evaluate(
        load_policy(policy, "touchdown", vehicle=flown),
        load_policy(baseline, "landing", vehicle=flown),
        frictions=friction,
        restitutions=restitution,
        effects=tuple(dict.fromkeys(effect)),
    )
    report["vehicle"] = str(vehicle) if vehicle is not None else "crazyflie.toml"
    runs.hand_over(report, show, json, out, {"flights.csv": csv(flights)})


def show(report: Mapping[str, Any]) -> None:
    """Print the report of `evaluate`."""
    angle = math.degrees(report["inclination"])
    named = [(f"mu {row['friction']:g}", row) for row in report["friction"]]
    named += [(f"restitution {row['restitution']:g}", row) for row in report["restitution"]]
    named += [("all", report["all"])] if report["all"] else []
    named += [(row["effect"], row) for row in report["effects"]]
    rows = [((label, motors), row[mode]) for label, row in named for mode, motors in MODES.items()]
    remarks = [
        "Shares have 95 % Wilson intervals. Speeds at the first touch, peak normal force on the feet (the "
        f"weight is {report['weight']:.2f} N) and time until rest are medians."
    ]
    for mu in report["cannot_hold"]:
        remarks.append(
            f"Not counted: friction {mu:g}, which is below tan({abs(angle):.1f} deg) and cannot hold the "
            "vehicle."
        )
    counted = [report["all"]] if report["all"] else report["effects"]
    ends = {
        mode: proportion(*(sum(row[mode]["at_rest"][key] for row in counted) for key in ("count", "of")))
        for mode in MODES
    }
    remarks.append(
        f"The touchdown policy came to rest on its feet in {count_words(ends['touchdown'])}; with the "
        f"motors cut in the goal box, in {count_words(ends['motor_cut'])}."
    )
    title = f"At rest on a slope of {abs(angle):.1f} deg, {report['starts']} starts per condition"
    table = outcomes_table(("", "motors"), rows)
    show_sections([Section("touchdown", title, [], [], [table], remarks=remarks)])
