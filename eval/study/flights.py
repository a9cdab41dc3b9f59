"""Flights of policies as tables, one row per flight.

Every table has `x y z` of the start and `end_x end_y end_z` [m], `success`, `touched` (whether a part touched
the platform), `strict` (success without a touch), `time` [s], `time_to_goal` [s], `reward`, and the
`measured` columns of the task. For landings whose motors are cut on arrival it also describes the entry into
the goal box and the result.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.measures import Row, median_of, share_of
from inclined_landing.envs.tasks import Start, Task
from inclined_landing.eval.study.engine import fact
from inclined_landing.eval.study.rest import VariantChoice, cut_motors
from inclined_landing.models import surface
from inclined_landing.models.attitude import LAG, PITCH, VX, VZ, YAW
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.plants import make_plant
from inclined_landing.models.vehicle import Vehicle

# How landings enter the goal box, of those whose motors are cut there, and what follows.
ARRIVAL = (
    median_of("entry_speed", "speed", "m/s", among="cut"),
    median_of("entry_normal_speed", "towards the slope", "m/s", among="cut"),
    median_of("entry_tangential_speed", "along the slope", "m/s", among="cut"),
    median_of("pitch_error", "pitch error", "rad", among="cut", digits=3),
    share_of("moving_away", "moving away", among="cut"),
    share_of("touchdown", "after the cut: touches the slope", among="cut"),
    median_of("normal_speed", "after the cut: normal touchdown speed", "m/s", among="cut"),
    median_of("tangential_speed", "after the cut: tangential touchdown speed", "m/s", among="cut"),
    share_of("at_rest_on_feet", "after the cut: at rest on feet after 2 s", among="cut"),
)
_NUMBERS = [m.name for m in ARRIVAL if m.unit != "1"]
_FLAGS = [m.name for m in ARRIVAL if m.unit == "1"]
_AT_ONCE = 1024  # flights; their records take some 80 MB


class SharedFlights:
    """Tables of cases that are simulated together, by number; they are simulated when one is first needed."""

    def __init__(self, tables: Iterator[pd.DataFrame]):
        self._remaining, self._known = tables, list[pd.DataFrame]()

    def table(self, k: int) -> pd.DataFrame:
        """Return the k-th table, whose case is `Case(labels, partial(shared.table, k))`."""
        while len(self._known) <= k:
            self._known.append(next(self._remaining))
        return self._known[k]


def named_policies(texts: Sequence[str]) -> dict[str, str]:
    """Return policies by name, from arguments of the command line: POLICY or LABEL=POLICY.

    A POLICY is a file, a shipped policy or a run folder; files of the same name are distinguished by their
    folders. Raises UserError if two have the same name.
    """
    labelled = ["=" in text and not os.path.exists(text) for text in texts]
    words = [text.partition("=")[::2] if split else ("", text) for text, split in zip(texts, labelled)]
    files = [Path(policy).name.removesuffix(".zip") for _, policy in words]
    found: dict[str, str] = {}
    for (label, policy), file in zip(words, files):
        folder = Path(policy).parent.name
        name = label or (f"{folder}/{file}" if files.count(file) > 1 and folder else file)
        if not (policy and name.isprintable()):
            raise UserError(
                f"a policy must be POLICY or LABEL=POLICY, not {shown(label + '=' + policy, 60)!r}"
            )
        if name in found:
            raise UserError(f"policy {shown(name, 100)} is named twice")
        found[name] = policy
    return found


def policy_facts(policies: Mapping[str, Policy]) -> list[Row]:
    """Return rows on the flown policies, with the options of their tasks."""
    facts = []
    for name, policy in policies.items():
        about = {"file": str(policy.path), "task": policy.task.name} | policy.task.options
        facts += [fact(name, key, value) for key, value in about.items()]
    return facts


def slope_words(task: Task) -> str:
    """Return the slopes of a task: "-25.7 deg", "up to +-25.7 deg" or "up to 30 deg, facing any way"."""
    if task.steepest is None:
        return f"{math.degrees(task.inclination):.1f} deg" if task.has_platform else ""
    steepest = f"{math.degrees(task.steepest):.3g} deg"
    return f"up to +-{steepest}" if task.is_planar else f"up to {steepest}, facing any way"


def fly(policy: Policy, starts: Start, plant: str, vehicle: Vehicle | None = None) -> pd.DataFrame:
    """Return a row for each flight of a policy from `starts`, without a motor cut.

    vehicle: the vehicle that flies, if it is not the policy's; see `fly_each`.
    """
    variant = policy.task.vehicle if vehicle is None else vehicle, 1.0
    return next(fly_each(policy, starts, plant, [variant], cut_from=len(starts)))


def fly_each(
    policy: Policy,
    starts: Start,
    plant: str,
    variants: Iterable[tuple[Vehicle, float]],
    *,
    cut_from: int = 0,
) -> Iterator[pd.DataFrame]:
    """Yield for each variant, a vehicle and the scale of its thrust, a row for each flight from `starts`.

    The policy does not observe how a vehicle differs from that of its task; all begin with the same load.
    cut_from: for landings, the first of the starts whose flights have their motors cut on arrival.
    """
    at_once = max(1, _AT_ONCE // len(starts))
    # A vehicle with a slung load has another model; all others fly together.
    for _, alike in itertools.groupby(variants, lambda variant: variant[0].effects_load_mass > 0.0):
        group = list(alike)
        for first in range(0, len(group), at_once):
            yield from _fly_batch(policy, starts, plant, group[first : first + at_once], cut_from)


def _fly_batch(
    policy: Policy, starts: Start, plant: str, variants: Sequence[tuple[Vehicle, float]], cut_from: int
) -> Iterator[pd.DataFrame]:
    """Yield what `fly_each` does; the flights of all variants are simulated together."""
    task, n = policy.task, len(starts)
    # One variant flies from all starts, then the next; 0 chooses the task's own vehicle, 1 the pool's first.
    variant, start = np.divmod(np.arange(n * len(variants)), n)  # of each flight
    vehicles, scales = zip(*variants)
    pool = list(dict.fromkeys(vehicle for vehicle in vehicles if vehicle != task.vehicle))
    chosen = np.array([0 if v == task.vehicle else 1 + pool.index(v) for v in vehicles])[variant]
    choice = VariantChoice(task.vehicle, pool, chosen, np.array(scales)[variant])
    starts = starts[start]
    # All begin with the same steady PWM: lag = PWM / rate.
    rates = np.array([vehicle.thrust_lag_rate for vehicle in vehicles])[variant]
    starts.state[:, LAG] *= task.vehicle.thrust_lag_rate / rates
    flown = choice.begin(make_plant(plant, len(starts), task.vehicle, pool=pool))
    flights = record_flights(policy, flown, starts, steps=task.judged_steps, informed=False)
    table = table_of(task, flights)
    if task.cut_at_success and cut_from < n:
        table = table.join(_arrivals(flights, table["success"].to_numpy() & (start >= cut_from), choice))
    for _, rows in table.groupby(variant):
        yield rows.reset_index(drop=True)


def table_of(task: Task, flights: Sequence[Flight]) -> pd.DataFrame:
    """Return a row for each flight, with the columns that every table has and those of the task."""
    first, last = (np.array([f.state[row] for f in flights]) for row in (0, -1))
    table = pd.DataFrame(
        {
            **dict(zip("xyz", first[:, :3].T)),
            "success": [f.success for f in flights],
            "touched": [f.touched for f in flights],
            "strict": [f.strict for f in flights],
            "time": [f.duration for f in flights],
            **dict(zip(("end_x", "end_y", "end_z"), last[:, :3].T)),
            "reward": [f.reward.sum() for f in flights],
        }
    )
    return table.assign(time_to_goal=table["time"].where(table["success"]), **task.measured(last))


def _arrivals(flights: Sequence[Flight], cut: np.ndarray, choice: VariantChoice) -> pd.DataFrame:
    """Return columns on the entry into the goal box, and on the result if the motors were `cut` (n,) there.

    Velocities in m/s, towards and along the slope; `pitch_error` in rad; False and NaN for other flights.
    """
    empty = dict.fromkeys(_NUMBERS, np.nan) | dict.fromkeys(_FLAGS, False)
    table = pd.DataFrame({"cut": cut}).assign(**empty)
    if not cut.any():
        return table
    arrived = [flight for flight, of in zip(flights, cut) if of]
    platform = np.array([flight.platform[-1] for flight in arrived])  # type: ignore[index]
    inclination = platform[:, PITCH]
    state = surface.turned(np.array([flight.state[-1] for flight in arrived]), -platform[:, YAW])
    velocity = state[:, VX : VZ + 1]
    away, along = surface.split(velocity, inclination)
    _, standing = surface.attitude_at_rest(inclination, -state[:, YAW])
    found = {
        "entry_speed": np.linalg.norm(velocity, axis=1),
        "entry_normal_speed": -away,
        "entry_tangential_speed": along,
        "pitch_error": np.abs(state[:, PITCH] - standing),
        "moving_away": away > 0,
        **cut_motors(state, inclination, choice[cut]),
    }
    for name, values in found.items():
        table.loc[cut, name] = np.asarray(values)
    return table
