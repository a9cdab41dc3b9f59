"""`landings`: effects of contact named from landings on contact that is not MuJoCo's.

Twelve landings of a healthy vehicle identify its contact, twelve others have a hidden cause; the next case
has other landings, and the same identification. The vehicle lands on the feet of the independent simulator
(springs, dampers and bristles) or on Bullet's contact (impulses, restitution, a friction cone).
"""

from __future__ import annotations

import functools
import importlib.util
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.eval.base.options import Folder
from inclined_landing.eval.gap.answer.touchdown import contact_effects
from inclined_landing.eval.gap.flights.landings import LandingReference, landings_of
from inclined_landing.eval.gap.infer.contact import contact_posterior
from inclined_landing.eval.gap.infer.landing_reference import landing_reference
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle
from tests.validation import simulator
from tests.validation.gap_blind import causes, generate
from tests.validation.gap_blind.accepted import EFFECT
from tests.validation.shared import answered, check_known, table_of

ENGINES = ("springs", "bullet")
COUNT = 12  # landings to identify with, and of a case
IDENTIFY = 99  # in place of the number of a case, in the seed of the landings
# Of one seed: every cause in every size, and after each size nothing hidden.
CASES = [(c, s if c else "") for s in causes.SIZES[::-1] for c in (*causes.LANDINGS, "")]


def flown(engine: str, cause: str, size: str, seed: tuple[int, int]) -> list[FlightLog]:
    """Return landings on an engine's contact with a cause hidden, or none."""
    if engine == "bullet":
        from tests.validation.gap_blind.bullet_reality import fly
    else:
        fly = simulator.fly
    rng = np.random.default_rng(seed)
    drawn = causes.draw(cause, size, rng) if cause else causes.Drawn({}, {})
    return generate.logs(generate.land_all(drawn, rng, count=COUNT, fly=fly), contact=True)


@functools.lru_cache(4)
def identified(engine: str, seed: int) -> tuple[Vehicle, LandingReference]:
    """Return the healthy vehicle that landings identify, and what these leave."""
    plain = flown(engine, "", "", (seed, IDENTIFY))
    vehicle, reference, _ = landing_reference(plain, load_vehicle(), LIBRARY)
    return vehicle, reference


def judged(engine: str, cause: str, size: str, seed: tuple[int, int]) -> list[dict]:
    """Return the effects named: class, probability, whether sure, value and interval."""
    vehicle, reference = identified(engine, seed[0])
    landings = landings_of(flown(engine, cause, size, seed), vehicle, reference)
    named = contact_effects(*contact_posterior(landings, vehicle, LIBRARY, reference))
    return [
        {"class": e.members, "probability": e.probability, "sure": e.sure, "value": p.value, "ci95": p.ci95}
        for e in named
        for p in e.parameters.values()
    ]


def command(
    out: Folder,
    engine: Annotated[str, tyro.conf.arg(metavar="{springs,bullet}")] = "springs",
    seed: Annotated[tuple[int, ...], tyro.conf.arg(metavar="SEED [SEED ...]")] = (501, 502, 503),
    processes: Annotated[int, Meta(ge=1, le=256)] = 2,
) -> None:
    """Hidden causes in landings of two engines: what gap names (half an hour a seed on one core).

    Args:
        out: folder for an answer a case; an interrupted run goes on in it.
        engine: the independent simulator's feet, or Bullet (needs pybullet).
        seed: of the sets, eighteen cases each.
        processes: cases judged at a time.
    """
    check_known("engine", [engine], ENGINES)
    if engine == "bullet" and importlib.util.find_spec("pybullet") is None:
        raise UserError("--engine bullet needs pybullet; pip install 'inclined-landing[baselines]'")
    calls = {
        f"{engine}_{s}_{k:02d}": (engine, cause, size, (s, k))
        for s in seed
        for k, (cause, size) in enumerate(CASES)
    }
    print(table_of(rows(list(calls.values()), list(answered(Path(out), judged, calls, processes).values()))))


def rows(calls: list[tuple], answers: list[list[dict]]) -> list[dict]:
    """Return by cause and size: right and alone, right among others or possible, sure and wrong."""
    found = []
    for cause, size in sorted(set(CASES), key=CASES.index):
        own = [a for (_, c, s, _), a in zip(calls, answers) if (c, s) == (cause, size)]
        right = [[bool(cause) and EFFECT.get(cause, cause) in e["class"] for e in a] for a in own]
        sure = [r for a, each in zip(own, right) for e, r in zip(a, each) if e["sure"]]
        alone = sum(len(a) == 1 and a[0]["sure"] and r[0] for a, r in zip(own, right))
        found.append(
            {
                "hidden": f"{cause}, {size}" if cause else "nothing",
                "sure and alone": proportion(alone, len(own)) if cause else None,
                "among the names": proportion(sum(map(any, right)), len(own)) if cause else None,
                "no name": proportion(sum(not a for a in own), len(own)),
                "sure names wrong": f"{sure.count(False)} of {len(sure)}",
            }
        )
    return found
