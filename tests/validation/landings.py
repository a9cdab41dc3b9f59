"""`landings`: effects of contact named from landings on contact that is not MuJoCo's.

Twelve landings of a healthy vehicle identify its contact, twelve others have a hidden cause; the next case
has other landings, and the same identification. The vehicle lands on the feet of the independent simulator:
springs, dampers and bristles.
"""

from __future__ import annotations

import functools
from typing import Annotated

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.eval.base.options import Folder
from inclined_landing.eval.gap.answer.touchdown import contact_effects
from inclined_landing.eval.gap.infer.contact import contact_posterior
from inclined_landing.eval.gap.infer.landing_reference import landing_reference
from inclined_landing.eval.gap.measured.landings import LandingReference, landings_of
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle
from tests.validation.gap_blind import causes, generate
from tests.validation.gap_blind.score import EFFECT
from tests.validation.shared import study, table_of

COUNT = 12  # landings to identify with, and of a case
IDENTIFY = 99  # in place of the number of a case, in the seed of the landings
# Of one seed: every cause in every size, and after each size nothing hidden.
CASES = [(c, s if c else "") for s in causes.SIZES[::-1] for c in (*causes.LANDINGS, "")]


def flown(cause: str, size: str, seed: tuple[int, int]) -> list[FlightLog]:
    """Return landings with a cause hidden, or none."""
    rng = np.random.default_rng(seed)
    drawn = causes.draw(cause, size, rng) if cause else causes.Drawn({}, {})
    return generate.logs(generate.land_all(drawn, rng, count=COUNT), contact=True)


@functools.lru_cache(4)
def identified(seed: int) -> tuple[Vehicle, LandingReference]:
    """Return the healthy vehicle that landings identify, and what these leave."""
    vehicle, reference, _ = landing_reference(flown("", "", (seed, IDENTIFY)), load_vehicle(), LIBRARY)
    return vehicle, reference


def judged(cause: str, size: str, seed: tuple[int, int]) -> list[dict]:
    """Return the effects named: class, probability, whether sure, value and interval."""
    vehicle, reference = identified(seed[0])
    landings = landings_of(flown(cause, size, seed), vehicle, reference)
    named = contact_effects(*contact_posterior(landings, vehicle, LIBRARY, reference))
    return [
        {"class": e.members, "probability": e.probability, "sure": e.sure, "value": p.value, "ci95": p.ci95}
        for e in named
        for p in e.parameters.values()
    ]


def command(
    out: Folder,
    seed: Annotated[tuple[int, ...], tyro.conf.arg(metavar="SEED [SEED ...]")] = (501, 502, 503),
    processes: Annotated[int, Meta(ge=1, le=256)] = 2,
) -> None:
    """Hidden causes in landings of the independent simulator: what gap names (half an hour a seed).

    Args:
        out: folder for results.json and table.md; an interrupted run goes on in it.
        seed: of the sets, eighteen cases each.
        processes: cases judged at a time.
    """
    calls = {f"{s}_{k:02d}": (c, size, (s, k)) for s in seed for k, (c, size) in enumerate(CASES)}
    study(out, judged, calls, processes, scored, seeds=seed)


def scored(answers: dict[str, list[dict]]) -> tuple[str, dict]:
    """Return the table of causes and sizes, and what results.json has of them."""
    rows = [row(cause, size, answers) for cause, size in dict.fromkeys(CASES)]
    return table_of(rows), {"rows": rows}


def row(cause: str, size: str, answers: dict[str, list[dict]]) -> dict:
    """Return of a cause and size: right and alone, right among others or possible, sure and wrong."""
    own = [answer for name, answer in answers.items() if CASES[int(name[-2:])] == (cause, size)]
    right = [[bool(cause) and EFFECT.get(cause, cause) in e["class"] for e in a] for a in own]
    sure = [hit for a, hits in zip(own, right) for e, hit in zip(a, hits) if e["sure"]]
    alone = sum(len(a) == 1 and a[0]["sure"] and hits[0] for a, hits in zip(own, right))
    return {
        "hidden": f"{cause}, {size}" if cause else "nothing",
        "sure and alone": proportion(alone, len(own)) if cause else None,
        "among the names": proportion(sum(map(any, right)), len(own)) if cause else None,
        "no name": proportion(sum(not a for a in own), len(own)),
        "sure names wrong": f"{sure.count(False)} of {len(sure)}",
    }
