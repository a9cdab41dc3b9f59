"""`landing-eval success`: share, time and speed with which policies reach their goals (`groups`)."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Annotated, Any

import tyro
from msgspec import Meta

from inclined_landing.envs.ids import SHIPPED
from inclined_landing.eval.base.options import MOST_COMPARED, Flag, Flat, Flown, NewFolder, Seed, ThrustScale
from inclined_landing.models.base.errors import UserError

Policies = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="POLICY [...]",
        help=f"policy files, run folders or shipped policies ({', '.join(SHIPPED)}), each flown on its task. "
        "LABEL=POLICY gives a name, LABEL@VEHICLE=POLICY a name and a vehicle.",
    ),
    Meta(max_length=MOST_COMPARED),
]
Scales = Annotated[
    tuple[tuple[ThrustScale, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X [X ...]")
]


def command(
    policies: Policies,
    /,
    *,
    flown: Flat[Flown] = Flown(),
    thrust_scale: Scales = (),
    seed: Seed = 0,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Compare policies: how often, how fast and how hard they reach their goals.

    Args:
        policies: policy files.
        thrust_scale: factors on the total thrust, one row for each (default: 1).
        seed: seed for the random starts.
        json: print only JSON on standard output.
        out: new folder for index.html, the numbers as JSON, flights.csv, and the figures.
    """
    if not policies:
        raise UserError("name at least one policy")
    from inclined_landing.eval.study import groups
    from inclined_landing.eval.study.engine import fact, run
    from inclined_landing.eval.study.flights import named_policies
    from inclined_landing.eval.study.show import hand_over

    scales = tuple(dict.fromkeys(itertools.chain(*thrust_scale))) or (1.0,)
    loaded, facts = {}, [fact("flights", "plant", flown.plant), fact("flights", "seed", seed)]
    for name, path in named_policies(policies).items():
        vehicle = "" if name == Path(path).stem else name.partition("@")[2]
        its = dataclasses.replace(flown, vehicle=Path(vehicle)) if vehicle else flown
        loaded[name] = its.load(path)
        facts.append(fact(name, "vehicle", str(its.vehicle or "crazyflie.toml")))
    options: dict[str, Any] = {"plant": flown.plant, "thrust_scales": scales, "seed": seed}
    found = [groups.study(alike, **options) for alike in groups.by_measures(loaded)]
    found[0] = dataclasses.replace(found[0], facts=[*facts, *found[0].facts])
    hand_over("success", run(found), json=json, out=out)
