"""`landing-eval touchdown`: at rest on the slope by the policy's own command, against cutting the motors.

From every start of the frozen grid, at each friction and restitution, two vehicles fly in the MuJoCo plant
(RK4, 4 ms):

- `motor_cut`: a landing policy; at its entry into the goal box the motors are cut from outside, as in the
  paper. It has 300 control steps to get there and 2 s more to come to rest;
- `touchdown`: a touchdown policy, which idles the motors itself, within 300 control steps.

Both are judged by the touchdown task: 0.3 s at rest on the feet; the floor ends a flight. A vehicle under
PWM 0 has no attitude torque. Speeds are those of the centre of mass before any part first meets the slab;
the peak normal force is that on the feet at any engine step. Where friction cannot hold the slope,
mu <= tan(inclination), nobody can come to rest: such conditions are named, not counted.

With ``--effect`` both also fly vehicles with one effect of the library at a plausible size, of which the
policies know nothing, on the contact of the vehicle file.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
import tyro
from rich.console import Console
from rich.progress import track

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.history import History
from inclined_landing.envs.mission import slope_normal
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion, spread
from inclined_landing.envs.shared.tables import count_words, new_table, say, share_cell, show_table
from inclined_landing.envs.tasks import StepContext
from inclined_landing.envs.tasks.landing import GOAL_SIZE
from inclined_landing.envs.tasks.touchdown import CONTACT_TIME, HOLD_STEPS, InclinedTouchdown, resting
from inclined_landing.eval.base.options import Flag, NewFolder, PolicyFile, PolicyName, VehicleFile
from inclined_landing.eval.policies.success import sizes
from inclined_landing.models import contact
from inclined_landing.models.attitude import LAG, PWM
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError, choices, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP, Recorder
from inclined_landing.models.vehicle import Vehicle

FRICTIONS = (0.5, 0.6, 0.8, 1.2)
RESTITUTIONS = (0.0, 0.25, 0.5)
SETTLING = 100  # control steps that the motor cut has after the goal box
MODES = ("motor_cut", "touchdown")
BASELINE = "landing-nominal"  # whose motors are cut
_FIELDS = ("at_rest", "normal_speed", "tangential_speed", "peak_normal_force", "time")


def land(
    policy: Policy,
    states: np.ndarray,
    friction: float | None = None,
    restitution: float | None = None,
    vehicle: Vehicle | None = None,
) -> pd.DataFrame:
    """Fly from `states` (n, 13); a landing policy gets its motors cut in the goal box.

    friction and restitution: None, both, for those of the vehicle. vehicle: the one that flies, where it is
    not the policy's; it begins with the same load.

    One row per flight: `at_rest`; at the first touch `normal_speed` into the surface and `tangential_speed`
    along it [m/s]; `peak_normal_force` on the feet [N]; `time` [s] until 0.3 s were held. NaN where none was.
    """
    task, n = policy.task, len(states)
    evaluated, cutting = task, task.cut_at_success
    if cutting:
        evaluated = InclinedTouchdown(task.vehicle)
    vehicle = task.vehicle if vehicle is None else vehicle
    tilt = vehicle.platform_inclination - task.vehicle.platform_inclination
    states = states.copy()
    states[:, LAG] *= task.vehicle.thrust_lag_rate / vehicle.thrust_lag_rate
    plant = MujocoPlant(n, vehicle, timestep=STEP)
    evaluated.prepare(plant)
    plant.set_platform(np.arange(n), task.inclination + tilt, azimuth=task.azimuth)
    if friction is not None:
        plant.set_contact(np.arange(n), friction=friction, restitution=restitution, contact_time=CONTACT_TIME)
    recorder = Recorder(plant, states)
    cut, ended = np.zeros(n, bool), np.zeros(n, bool)
    past = History(task, n)

    def seen() -> np.ndarray:
        return task.observe(StepContext(plant.state, plant.contacts, platform=plant.platform))

    past.reset(slice(None), seen())
    held, last, time = np.zeros(n, int), np.full(n, task.max_steps), np.full(n, np.nan)
    for tick in range(1, task.max_steps + SETTLING + 1):
        observation = seen()
        actions = policy.predict(past.stack(observation)).astype(float)
        past.record(observation, actions)
        commands = task.body_commands(task.commands(actions), plant.state, plant.platform)
        if cutting:
            entered = ~cut & task.in_goal(plant.state, GOAL_SIZE, plant.platform)
            last[entered] = tick - 1 + SETTLING
            cut |= entered
            commands[cut, PWM] = 0.0
        recorder.step(commands, np.flatnonzero(~ended))
        holding = resting(plant.state, plant.platform, commands[:, PWM] == 0.0, plant.contacts)
        held = np.where(holding, held + 1, 0)
        rests = (held >= HOLD_STEPS) & ~ended
        time[rests] = tick * plant.control_period
        ended |= rests | (tick >= last) | plant.contacts.touch[:, 2].any(axis=1)
        if ended.all():
            break
    into, along = recorder.touch_speeds()
    peak = np.where(recorder.touched, recorder.feet_force, np.nan)
    return pd.DataFrame(dict(zip(_FIELDS, (~np.isnan(time), into, along, peak, time))))


def evaluate(
    policy: Policy,
    baseline: Policy,
    *,
    frictions: Sequence[float] = FRICTIONS,
    restitutions: Sequence[float] = RESTITUTIONS,
    effects: Sequence[str] = (),
) -> dict:
    """Return the comparison as plain numbers; effects: of the library, one entry of `effects` for each."""
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
    held = sorted({mu for mu in frictions if mu > slip})
    pairs = list(itertools.product(held, sorted(set(restitutions))))
    changed = {name: LIBRARY[name].apply(task.vehicle, LIBRARY[name].plausible) for name in effects}
    flown = []
    cases: list[dict[str, Any]] = [dict(zip(("friction", "restitution"), pair)) for pair in pairs]
    cases += [{"effect": name} for name in changed]
    work = list(itertools.product(zip(MODES, (baseline, policy)), cases))
    for (mode, pilot), case in track(work, "landing", console=Console(stderr=True), transient=True):
        found = land(
            pilot, states, case.get("friction"), case.get("restitution"), changed.get(case.get("effect", ""))
        )
        flown.append(found.assign(mode=mode, **case))
    whole = pd.concat(flown) if flown else pd.DataFrame()
    flights = whole[whole["friction"].notna()] if pairs else pd.DataFrame()

    def both(part: pd.DataFrame) -> dict:
        return {mode: _summary(part[part["mode"] == mode]) for mode in MODES}

    def by(*names: str) -> list[dict]:
        parts = flights.groupby(list(names)) if pairs else ()
        return [dict(zip(names, map(float, values))) | both(part) for values, part in parts]

    return {
        "command": "touchdown",
        "policy": str(policy.path),
        "baseline": str(baseline.path),
        "trained": policy.metadata,
        "inclination": task.inclination,
        "starts": len(states),
        "weight": task.vehicle.body_mass * task.vehicle.environment_gravity,
        "cannot_hold": sorted({float(mu) for mu in frictions if mu <= slip}),
        "all": both(flights) if pairs else None,
        "friction": by("friction"),
        "restitution": by("restitution"),
        "conditions": by("friction", "restitution"),
        "effects": [
            {"effect": name, "parameters": sizes(LIBRARY[name], LIBRARY[name].plausible)}
            | both(whole[whole["effect"] == name])
            for name in changed
        ],
        "versions": runs.versions(),
    }


def _summary(flights: pd.DataFrame) -> dict:
    """Return the share at rest and spreads."""
    rest = proportion(flights["at_rest"].sum(), len(flights))
    return {"at_rest": rest} | {name: spread(flights[name]) for name in _FIELDS[1:]}


def overall(report: dict, mode: str) -> dict | None:
    """Return the share at rest over all conditions that friction can hold."""
    return report["all"][mode]["at_rest"] if report["all"] else None


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
    """Touchdown policy beside a landing policy whose motors are cut (minutes).

    Args:
        policy: touchdown policy file, or the shipped one (touchdown).
        baseline: landing policy file, or a shipped one; landing-nominal is the paper's.
        vehicle: vehicle file (TOML), where it differs from the shipped one.
        friction: between feet and slope.
        restitution: of the feet on the slope, 0 to 0.6.
        effect: of the library, at a plausible size, which the policies know nothing of (default: none).
        json: print JSON, and nothing else, on standard output.
        out: new folder for touchdown.json.
    """
    if not (friction and restitution):
        raise UserError("give at least one --friction and one --restitution")
    contact.check_friction(friction)
    contact.check_restitution(restitution)
    for name in effect:
        if name not in LIBRARY:
            raise UserError(f"unknown effect {shown(name, 40)}; {choices(LIBRARY, name)}")
    if out is not None:
        runs.check_new_run(out)
    flown = load_vehicle(vehicle) if vehicle is not None else None
    report = evaluate(
        load_policy(policy, "touchdown", vehicle=flown),
        load_policy(baseline, "landing", vehicle=flown),
        frictions=friction,
        restitutions=restitution,
        effects=tuple(dict.fromkeys(effect)),
    )
    report["vehicle"] = str(vehicle) if vehicle is not None else "crazyflie.toml"
    runs.hand_over(report, show, json, out)


def show(report: dict) -> None:
    """Print the report of `evaluate`."""
    angle = math.degrees(report["inclination"])
    title = f"At rest on a slope of {abs(angle):.1f} deg, {report['starts']} starts each"
    names = ("", "motors", "at rest [%]", "into it [m/s]", "along it [m/s]", "peak [N]", "time [s]")
    shown = new_table(title, *names, left=2)
    rows = [(f"mu {row['friction']:g}", row) for row in report["friction"]]
    rows += [(f"restitution {row['restitution']:g}", row) for row in report["restitution"]]
    if report["all"]:
        rows.append(("all", report["all"]))
    rows += [(row["effect"], row) for row in report["effects"]]
    for label, row in rows:
        for mode, who in zip(MODES, ("cut in the goal box", "touchdown policy")):
            cells = [share_cell(row[mode]["at_rest"])]
            cells += [_median(row[mode][name]) for name in _FIELDS[1:]]
            shown.add_row(label if mode == MODES[0] else "", who, *cells)
        shown.add_section()
    shown.caption = (
        "95 % Wilson intervals; speeds at the first touch, peak normal force on the feet (the weight is "
        f"{report['weight']:.2f} N) and time: medians"
    )
    show_table(shown)
    for mu in report["cannot_hold"]:
        say(f"mu {mu:g} cannot hold this slope (tan {abs(angle):.1f} deg is more): not counted")
    counted = [report["all"]] if report["all"] else report["effects"]
    ends = {
        mode: {key: sum(row[mode]["at_rest"][key] for row in counted) for key in ("count", "of")}
        for mode in MODES
    }
    rests = {mode: count_words(proportion(end["count"], end["of"])) for mode, end in ends.items()}
    say(
        f"The touchdown policy came to rest on its feet in {rests['touchdown']}; with motors cut in the "
        f"goal box, in {rests['motor_cut']}."
    )


def _median(value: dict) -> str:
    return "-" if value["median"] is None else f"{value['median']:.2f}"
