"""The answer of the landings: effects of contact, and errors after the touch."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.infer.contact import ContactPosterior, contact_posterior, look_alike
from inclined_landing.eval.gap.infer.sets import confounded_with
from inclined_landing.eval.gap.infer.touchdown_simulation import TouchdownProblem
from inclined_landing.eval.gap.measured.landings import LandingReference, landings_of
from inclined_landing.eval.gap.measured.usable import UsableFlights
from inclined_landing.eval.gap.result import NamedEffect, ScoredSet
from inclined_landing.models.effects import Effect
from inclined_landing.models.vehicle import Vehicle

LAWS_DIFFER = (
    "In doubt, because laws of contact differ: by another law than MuJoCo's, these landings may show another "
    "effect of its class, and more landings do not help."
)


@dataclasses.dataclass(frozen=True)
class ContactAnswer:
    """The result for landings; without a posterior if there are too few."""

    vehicle: Vehicle  # corrected for contact too
    effects: tuple[NamedEffect, ...] = ()
    posterior: ContactPosterior | None = None
    notes: tuple[str, ...] = ()

    def sets(self, flown: tuple[ScoredSet, ...]) -> tuple[ScoredSet, ...]:
        """Return the joint sets of free flight and contact."""
        return joint_sets(flown, self.posterior) if self.posterior else flown


def contact_answer(
    use: UsableFlights,
    vehicle: Vehicle,
    corrected: Vehicle,
    library: Mapping[str, Effect],
    reference: LandingReference | None = None,
) -> ContactAnswer:
    """Return the effects of contact that the landings of the flights show.

    vehicle: the one diagnosed; corrected: for free flight; reference: of its own landings.
    """
    landings = landings_of(use.logs, corrected, reference)
    if len(landings) < thresholds.LEAST_LANDINGS or not any(e.contact for e in library.values()):
        few = f"only {len(landings)} touchdown{'s' * (len(landings) > 1)}"
        note = f"{few}: contact effects need {thresholds.LEAST_LANDINGS}"
        return ContactAnswer(corrected, notes=(note,) if landings else ())
    problem, found = contact_posterior(landings, corrected, library, reference)
    effects = contact_effects(problem, found)
    after = problem.corrected({n: v for e in effects for n, v in e.fitted.items()})
    notes: tuple[str, ...] = ()
    if found.touchdowns.unexplained:
        repeats = "the motion after touchdown has a systematic error that no effect explains"
        notes = (f"{repeats} (p {found.touchdowns.p_value:.2g})",)
    return ContactAnswer(after, effects, found, notes)


def contact_effects(problem: TouchdownProblem, found: ContactPosterior) -> tuple[NamedEffect, ...]:
    """Return the named contact effects with estimates, most probable first."""
    effects = []
    for name, estimate in found.sizes.items():
        (p,) = problem.library[name].parameters
        alike = _look_alike(problem, name, estimate.value)
        members = tuple(dict.fromkeys((name, *confounded_with(found.sets, found.names, name), *alike)))
        if found.probability(*members) < thresholds.NAMED:
            continue
        effects.append(
            NamedEffect(
                name,
                members,
                found.probability(*members),
                {p.name: estimate},
                math.nan,
                problem.library[name].remedy,
                doubt=LAWS_DIFFER if alike else "",
            )
        )
    return tuple(sorted(effects, key=lambda e: -e.probability))


def _look_alike(problem: TouchdownProblem, name: str, value: float) -> tuple[str, ...]:
    """Return the effects of the problem that look like one at a value under another law of contact."""
    (p,) = problem.library[name].parameters
    others = look_alike(name, p.coordinate(value) / abs(p.coordinate(p.plausible)))
    return tuple(n for n in others if n in problem.library)


def joint_sets(flown: tuple[ScoredSet, ...], found: ContactPosterior) -> tuple[ScoredSet, ...]:
    """Return the product of the posteriors of free-flight and contact sets, most probable first."""
    total = sum(other.probability for other in found.sets)
    both = [
        ScoredSet(
            (*one.effects, *other.effects),
            one.probability * other.probability / total,
            {**one.values, **other.values},
            one.standard_errors,
        )
        for one in flown
        for other in found.sets
    ]
    both.sort(key=lambda one: -one.probability)
    # Many small products together are not small: all that could change a marginal probability stay.
    return tuple(one for k, one in enumerate(both) if not k or one.probability >= thresholds.REPORTED**2)
