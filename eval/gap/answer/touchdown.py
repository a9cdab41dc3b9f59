"""The answer of the landings: effects of contact, and errors after the touch."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.infer.contact import ContactPosterior, contact_posterior, look_alike
from inclined_landing.eval.gap.infer.sets import confounded_with
from inclined_landing.eval.gap.infer.touchdown_simulation import TouchdownProblem, position_errors
from inclined_landing.eval.gap.measured.landings import AFTER, BEFORE, Landing, LandingReference, landings_of
from inclined_landing.eval.gap.measured.usable import UsableFlights
from inclined_landing.eval.gap.result import NamedEffect, PlantGap, RegimeError, ScoredSet
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
    landings: tuple[Landing, ...] = ()  # those judged on
    effects: tuple[NamedEffect, ...] = ()
    where: tuple[RegimeError, ...] = ()
    posterior: ContactPosterior | None = None
    notes: tuple[str, ...] = ()

    def sets(self, flown: tuple[ScoredSet, ...]) -> tuple[ScoredSet, ...]:
        """Return the joint sets of free flight and contact."""
        return joint_sets(flown, self.posterior) if self.posterior else flown

    def gap(self, before: Vehicle, plants: Sequence[str]) -> dict[str, PlantGap]:
        """Return the gap of logs with landings only: error at the end of the motion after the touch."""
        if not self.landings or "mujoco" not in plants:
            return {}
        worse, better = (_root_mean_square(self.landings, v, slice(-1, None)) for v in (before, self.vehicle))
        floor = float(np.sqrt(np.mean([(x.deviation[-1, :3] ** 2).sum() for x in self.landings])))
        gap = PlantGap(worse, better, floor, len(self.landings), BEFORE + AFTER)
        return {"mujoco": gap}


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
    notes = _undecided(problem, found, effects)
    if found.touchdowns.unexplained:
        repeats = "the motion after touchdown has a systematic error that no effect explains"
        notes = (f"{repeats} (p {found.touchdowns.p_value:.2g})", *notes)
    test = tuple(landings_of(use.heldout, corrected, reference) or landings)
    worse, better = (_root_mean_square(test, v, slice(None)) for v in (vehicle, after))
    floor = float(np.sqrt(np.mean([(x.deviation[:, :3] ** 2).sum(axis=1).mean() for x in test])))
    where = (RegimeError("touchdown", "touchdown", worse, better, floor, "m", len(test)),)
    return ContactAnswer(after, test, effects, where, found, notes)


def _root_mean_square(landings: Sequence[Landing], vehicle: Vehicle, moments: slice) -> float:
    """Return the position error [m] after the touch at some of the compared moments."""
    return float(np.sqrt((position_errors(landings, vehicle)[:, moments] ** 2).mean()))


def contact_effects(problem: TouchdownProblem, found: ContactPosterior) -> tuple[NamedEffect, ...]:
    """Return the named contact effects with estimates, largest gain first."""
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
                found.gains[name],
                problem.library[name].remedy,
                doubt=LAWS_DIFFER if alike else "",
            )
        )
    return tuple(sorted(effects, key=lambda e: -e.gain))


def _look_alike(problem: TouchdownProblem, name: str, value: float) -> tuple[str, ...]:
    """Return the effects of the problem that look like one at a value under another law of contact."""
    (p,) = problem.library[name].parameters
    others = look_alike(name, p.coordinate(value) / abs(p.coordinate(p.plausible)))
    return tuple(n for n in others if n in problem.library)


def _undecided(
    problem: TouchdownProblem, found: ContactPosterior, named: Sequence[NamedEffect]
) -> tuple[str, ...]:
    """Return a note on the likeliest effect that is not named."""
    among = {name for one in named for name in one.members}
    others = {n: found.probability(n) for s in found.sets for n in s.effects if n not in among}
    likely = max(others, key=lambda n: others[n], default="")
    if not likely or others[likely] < thresholds.POSSIBLE:
        return ()
    ((_, size),) = next(s.values[likely] for s in found.sets if likely in s.effects).items()
    what = " or ".join(n.replace("_", " ") for n in (likely, *_look_alike(problem, likely, size)))
    return (f"{found.touchdowns.landings} landings leave open whether {what} is missing",)


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
