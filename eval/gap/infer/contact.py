"""Posterior over sets of contact effects from landings: friction, stiffness, damping, the platform's pose.

As for free flight, every set is a candidate with a spike-and-slab prior: a slab as wide as is plausible, of
the logarithm where the parameter is a factor, and a spike as wide as laws of contact differ.
Contact is far from linear, so that an effect's errors are simulated on a grid of its sizes and its part of
the marginal likelihood is a sum over that grid; all others are marginalised by Laplace approximation.

The errors of one axis of a landing have a multivariate t distribution: outliers are whole axes. Samples of an
axis and axes of a landing are correlated; a variance inflation from the scores of single landings allows for
that. Probabilities are means over bootstrap samples of the landings (bagged posterior).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, logsumexp

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.infer.gaussian import SPIKE, EffectSet, flight_weights, prior_share
from inclined_landing.eval.gap.infer.sets import confounded_with
from inclined_landing.eval.gap.infer.touchdown_simulation import TouchdownProblem
from inclined_landing.eval.gap.measured.landings import Landing, LandingReference, landings_of
from inclined_landing.eval.gap.measured.usable import UsableFlights
from inclined_landing.eval.gap.model.columns import FittedValues, Values
from inclined_landing.eval.gap.result import Estimate, NamedEffect, ScoredSet, Touchdowns, marginal
from inclined_landing.models.effects import Effect
from inclined_landing.models.vehicle import Vehicle

SCAN = (0.2, 0.55, 1.1, 2.4, 4.5)  # sizes simulated on both sides of neutral, in plausible sizes
REFINEMENTS = 2  # grid points added at the mode
FINE_GRID = np.linspace(-6.0, 6.0, 25)  # posterior standard deviations about the mode, of the sum's terms
NEWTON_STEPS = 2  # of the marginalised parameters
CREDIBLE = 0.95  # probability of an interval
COMMON_MODES = 4  # eigenvectors of the contact model error that are tested for a common residual


# Differences between laws of contact: which effects are not identifiable, and which are confounded. MuJoCo's
# contact is a damped spring on accelerations, with friction that answers within 1/damping. Other engines have
# other laws, and nature has another again. The numbers were measured with MuJoCo's law on landings of two
# engines, Bullet (impulses, restitution, a friction cone; tests/validation of commit cd884583) and the
# independent simulator of tests/validation (springs and dampers on forces, bristles), and on tosses of a real
# cube (tests/validation/tosses.py): see docs/evidence/hidden_effects.md.


class Scatter(NamedTuple):
    """Standard deviation of an effect's size between laws of contact, in plausible sizes."""

    alone: float  # of the size itself, where landings are compared with the vehicle file
    referred: float  # of its difference to the reference vehicle's landings


# Friction: scatter of a real cube's between strikes, tumbling and sliding (0.18 to 0.24); alone, that between
# engines too. Feet, after a reference: scatter of the cube's height at rest between kinds of motion, 0.7 mm.
SCATTER = {
    "friction": Scatter(0.25, 0.21),
    "contact_stiffness": Scatter(0.6, 0.3),
    "contact_damping": Scatter(0.5, 0.2),
    "foot_height": Scatter(0.3, 0.17),
    "platform_height": Scatter(0.1, 0.1),
    "platform_tilt": Scatter(0.18, 0.16),
}
OF_OTHERS = Scatter(0.5, 0.3)  # of effects of other libraries: as wide as those of the spring


class Lookalikes(NamedTuple):
    """The effects confounded with one of a size from low to high, under another contact law."""

    effects: tuple[str, ...] = ()
    low: float = -math.inf  # in plausible sizes
    high: float = math.inf


# Feet that rebound or yield under one law are rougher or shorter under another. Stiffer feet raise a vehicle
# by at most the 1.6 mm by which its weight compresses them: longer feet are not confounded with them.
LOOKS_LIKE = {
    "friction": Lookalikes(("contact_damping", "contact_stiffness"), low=0.0),
    "contact_damping": Lookalikes(("contact_stiffness", "friction")),
    "contact_stiffness": Lookalikes(("contact_damping", "foot_height", "friction")),
    "foot_height": Lookalikes(("contact_stiffness",), low=-1.1, high=0.6),
}


LAWS_DIFFER = (
    "In doubt, because laws of contact differ: by another law than MuJoCo's, these landings may show another "
    "effect of its class, and more landings do not help."
)


@dataclasses.dataclass(frozen=True)
class ContactPosterior:
    """Posterior over sets of contact effects, with estimates of the most probable set."""

    sets: tuple[ScoredSet, ...]  # most probable first
    sizes: dict[str, Estimate]  # of the most probable set
    touchdowns: Touchdowns  # what the set leaves

    @property
    def names(self) -> EffectSet:
        """Return the most probable set."""
        return self.sets[0].names

    def probability(self, *names: str) -> float:
        """Return the marginal probability that at least one of some effects is missing."""
        return marginal(self.sets, names)


def contact_posterior(
    landings: Sequence[Landing],
    vehicle: Vehicle,
    library: Mapping[str, Effect],
    reference: LandingReference | None = None,
) -> tuple[TouchdownProblem, ContactPosterior]:
    """Return the posterior over sets of contact effects; `vehicle` is corrected for free flight.

    reference: whose mean residual the landings expect.
    """
    problem = TouchdownProblem.of(landings, vehicle, library)
    # The mean of m landings subtracted from each of n: its error is theirs in common.
    inflated = 1.0 + len(landings) / sum(reference.count) if reference else 1.0
    engine = _ContactModel(problem, inflated, reference is not None)
    sets, chosen = engine.distribution()
    sizes = {engine.names[j]: engine.estimate(j, profile) for j, profile in chosen.items()}
    p_value = common_residual_p_value(problem.landings, engine.residual(sets[0].values), engine.inflation)
    touchdowns = Touchdowns(len(landings), p_value < thresholds.LANDING_RESIDUAL, p_value)
    return problem, ContactPosterior(sets, sizes, touchdowns)


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
    corrected: Vehicle,
    library: Mapping[str, Effect],
    reference: LandingReference | None = None,
) -> ContactAnswer:
    """Return the effects of contact that the landings of the flights show.

    corrected: the vehicle, for free flight; reference: of the landings that it was identified from.
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
    """Return the named contact effect with its estimate, if there is one."""
    effects = []
    for name, estimate in found.sizes.items():
        (p,) = problem.library[name].parameters
        alike = look_alike(problem, name, estimate.value)
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
    return tuple(effects)


def look_alike(problem: TouchdownProblem, name: str, value: float) -> tuple[str, ...]:
    """Return the effects that look like one at a value under another law of contact."""
    (p,) = problem.library[name].parameters
    known, size = LOOKS_LIKE.get(name, Lookalikes()), p.coordinate(value) / abs(p.coordinate(p.plausible))
    return tuple(n for n in known.effects if n in problem.library and known.low < size < known.high)


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


@dataclasses.dataclass(frozen=True)
class _ErrorGrid:
    """White errors (m, n, 6, q) of the landings on a grid of sizes (m,) of one effect."""

    sizes: np.ndarray
    errors: np.ndarray

    def at(self, sizes: np.ndarray) -> np.ndarray:
        """Return the errors (k, n, 6, q) interpolated linearly to sizes (k,)."""
        k = np.clip(np.searchsorted(self.sizes, sizes) - 1, 0, len(self.sizes) - 2)
        share = ((sizes - self.sizes[k]) / (self.sizes[k + 1] - self.sizes[k]))[:, None, None, None]
        return (1.0 - share) * self.errors[k] + share * self.errors[k + 1]

    def slopes(self) -> np.ndarray:
        """Return the Jacobian (n, 6, q) of the simulated motion at neutral, by a central difference."""
        k = int(np.searchsorted(self.sizes, 0.0))
        low, high = max(k - 1, 0), min(k + 1, len(self.sizes) - 1)
        return -(self.errors[high] - self.errors[low]) / (self.sizes[high] - self.sizes[low])

    def with_one(self, size: float, errors: np.ndarray) -> _ErrorGrid:
        """Return the grid with the errors (n, 6, q) at one more size."""
        k = int(np.searchsorted(self.sizes, size))
        return _ErrorGrid(np.insert(self.sizes, k, size), np.insert(self.errors, k, errors, axis=0))


@dataclasses.dataclass(frozen=True)
class _Profile:
    """Log evidence of an effect, or of none, along a grid of one effect's sizes, the others marginalised."""

    sizes: np.ndarray  # (m,)
    log: np.ndarray  # (d, m) of bootstrap samples (all landings first), prior and spacing included
    best: float  # the size at the posterior mode

    @property
    def evidence(self) -> np.ndarray:
        """Return the log marginal likelihoods (d,)."""
        return logsumexp(self.log, axis=1)


class _Marginal(NamedTuple):
    """Evidence at m sizes of one effect, the others marginalised."""

    log: np.ndarray  # (m, d) log evidence of bootstrap samples, all landings first
    mode: np.ndarray  # (m, P) posterior mode of all effects, from neutral
    information: np.ndarray  # (m, n, P) about all effects, by landing


class _ContactModel:
    """Simulated errors on a grid of every effect (one parameter each), and the evidence of every set."""

    def __init__(self, problem: TouchdownProblem, inflated: float = 1.0, referred: bool = False):
        self.problem = problem
        self.names = list(problem.library)
        self.parameters = [problem.library[n].parameters[0] for n in self.names]
        n = len(problem.landings)
        self.weights = np.vstack([np.ones(n), flight_weights(n)])
        self.slab = np.array([abs(p.coordinate(p.plausible)) for p in self.parameters])
        spike = [SPIKE * abs(p.coordinate(p.neutral + p.negligible)) for p in self.parameters]
        laws = [SCATTER.get(n, OF_OTHERS) for n in self.names]
        scatter = [one.referred if referred else one.alone for one in laws]
        self.spike = np.hypot(np.array(scatter) * self.slab, spike)
        self.neutral = problem.errors(problem.vehicle)
        self.scans = [self._scan(j) for j in range(len(self.names))]
        self.slopes = np.stack([scan.slopes() for scan in self.scans], axis=-1)  # (n, 6, q, P)
        everywhere = np.concatenate([scan.errors for scan in self.scans])
        nearest = everywhere[np.argmin(-log_t(everywhere).sum(axis=(1, 2)))]
        self.inflation = inflated * inflation(nearest, self.slopes)
        self.scans = [self._refined(j, scan) for j, scan in enumerate(self.scans)]

    def _errors(self, sizes: Mapping[int, float]) -> np.ndarray:
        """Return the errors (n, 6, q) with effects at `sizes`, by index."""
        return self.problem.errors(self.problem.corrected(self._values(sizes)))

    def _values(self, sizes: Mapping[int, float]) -> FittedValues:
        """Return the parameter values of effects at `sizes`, by index, within bounds."""
        named = {self.names[j]: (self.parameters[j], size) for j, size in sizes.items()}
        return {n: {named[n][0].name: named[n][0].bounded(named[n][1])} for n in self.names if n in named}

    def _scan(self, j: int) -> _ErrorGrid:
        """Return the errors simulated on the grid SCAN of effect j."""
        p = self.parameters[j]
        grid = np.outer((-1.0, 1.0), SCAN).ravel() * self.slab[j]
        sizes = sorted({p.coordinate(p.bounded(x)) for x in grid} | {0.0})
        errors = [self._errors({j: x}) if x else self.neutral for x in sizes]
        return _ErrorGrid(np.array(sizes), np.stack(errors))

    def _widths(self, own: int | None) -> np.ndarray:
        """Return the prior standard deviations (P,): the slab of one effect, spikes for the others."""
        return np.where(np.arange(len(self.names)) == own, self.slab, self.spike)

    def _refined(self, j: int, scan: _ErrorGrid) -> _ErrorGrid:
        """Return the grid with a point added at the posterior mode, REFINEMENTS times."""
        width = self._widths(j)
        for _ in range(REFINEMENTS):
            sizes = _subdivided(scan.sizes, 4)
            local = self._marginalised(j, scan.at(sizes), width)
            best = float(sizes[np.argmax(local.log[:, 0] + _log_prior(sizes, width[j]))])
            if np.abs(scan.sizes - best).min() < 1e-3 * self.slab[j]:
                break
            scan = scan.with_one(best, self._errors({j: best}))
        return scan

    def _marginalised(self, j: int | None, errors: np.ndarray, width: np.ndarray) -> _Marginal:
        """Return the evidence of errors (m, n, 6, q), all effects but j marginalised (Laplace).

        width (P,): prior standard deviations.
        """
        # Mode x by iteratively reweighted least squares (t weights w), Jacobian J, prior precision K:
        #   x += (J'wJ + K)^-1 (J'w e - K x)
        # and, with H = J'wJ + K and h the gradient at x,
        #   log p = sum log t(e) - 1/2 x'K x + 1/2 h'H^-1 h - 1/2 log det H + 1/2 log det K
        count = len(self.names)
        free = np.ones(count) if j is None else np.arange(count) != j
        precision = width**-2.0 * np.where(free, 1.0, 1e12)
        prior = np.diag(precision)
        share = 1.0 / self.inflation
        slopes, m = self.slopes, np.zeros((len(errors), count))
        squares = np.einsum("icqp,icqs->icps", slopes, slopes, optimize=True)
        for step in range(NEWTON_STEPS + 1):
            residual = errors - np.einsum("icqp,mp->micq", slopes, m, optimize=True) if step else errors
            weight = weights(residual) * share
            b = np.einsum("micq,icqp,mic->mip", residual, slopes, weight, optimize=True)
            a = np.einsum("icps,mic->mips", squares, weight, optimize=True)
            if step < NEWTON_STEPS:
                h = b.sum(axis=1) - precision * m
                m = m + np.linalg.solve(a.sum(axis=1) + prior, h[..., None])[..., 0]
        each = (log_t(residual) * share).sum(axis=-1)
        total = np.einsum("di,mips->mdps", self.weights, a, optimize=True) + prior
        h = np.einsum("di,mip->mdp", self.weights, b) - (precision * m)[:, None]
        square = (h * np.linalg.solve(total, h[..., None])[..., 0]).sum(axis=-1)
        prior_penalty = (precision * free * m**2).sum(axis=1)[:, None]
        log = each @ self.weights.T - 0.5 * (prior_penalty - square)
        log -= 0.5 * (np.linalg.slogdet(total)[1] - np.log(precision).sum())
        return _Marginal(log, m, np.einsum("mipp->mip", a))

    def profile(self, own: int | None, j: int) -> _Profile:
        """Return the log evidence of effect `own` (None: of none) along a grid of effect j, refined."""
        scan, width = self.scans[j], self._widths(own)
        sizes = _subdivided(scan.sizes, 2)
        coarse = self._marginalised(j, scan.at(sizes), width)
        k = int(np.argmax(coarse.log[:, 0] + _log_prior(sizes, width[j])))
        spread = 1.0 / math.sqrt(coarse.information[k, :, j].sum() + 1.0 / width[j] ** 2)
        sizes = np.concatenate([sizes, sizes[k] + spread * FINE_GRID])
        sizes = np.unique(np.clip(sizes, scan.sizes[0], scan.sizes[-1]))
        fine = self._marginalised(j, scan.at(sizes), width)
        # p(data | S) = sum_x p(data | x) p(x) dx
        log = fine.log.T + _log_prior(sizes, width[j]) + np.log(np.gradient(sizes))
        return _Profile(sizes, log, float(sizes[np.argmax(log[0] - np.log(np.gradient(sizes)))]))

    def distribution(self) -> tuple[tuple[ScoredSet, ...], dict[int, _Profile]]:
        """Return the bagged posterior, most probable first, and the profile of its effect, by index."""
        share, every = prior_share(len(self.names)), range(len(self.names))
        odds = math.log(share / (1.0 - share))
        table = {own: [self.profile(own, j) for j in every] for own in (None, *every)}
        # The evidence is that along the grid on which the set is most probable.
        evidence = {
            own: max((x.evidence for x in profiles), key=lambda of: float(of[0])) + (own is not None) * odds
            for own, profiles in table.items()
        }
        logs = np.stack(list(evidence.values()))[:, 1:]
        probability = dict(zip(evidence, np.exp(logs - logsumexp(logs, axis=0)).mean(axis=1)))
        order = sorted(table, key=lambda own: -probability[own])
        kept = [own for k, own in enumerate(order) if not k or probability[own] >= thresholds.REPORTED]
        best = [{} if own is None else {own: table[own][own]} for own in kept]
        values = [self._values({j: x.best for j, x in one.items()}) for one in best]
        scored = (ScoredSet(tuple(v), float(probability[own]), v) for own, v in zip(kept, values))
        return tuple(scored), best[0]

    def estimate(self, j: int, profile: _Profile) -> Estimate:
        """Return the estimate of effect j with its credible interval."""
        p = self.parameters[j]
        density = np.exp(profile.log[1:] - profile.evidence[1:, None]).mean(axis=0)
        below = np.cumsum(density) - 0.5 * density
        ends = np.interp([0.5 - 0.5 * CREDIBLE, 0.5 + 0.5 * CREDIBLE], below, profile.sizes)
        value = p.bounded(profile.best)
        low, high = (p.bounded(x) for x in ends)
        return Estimate(
            value=value,
            unit=p.unit,
            ci95=(min(low, value), max(high, value)),
            neutral=p.neutral,
            bounds=p.bounds,
            at_bound=thresholds.at_bound(value, p.bounds),
        )

    def residual(self, values: Values) -> np.ndarray:
        """Return the residual (n, 6, q) at `values`, small (spike) errors of all effects removed."""
        errors = self.problem.errors(self.problem.corrected(values))[None]
        small = self._marginalised(None, errors, self.spike).mode[0]
        return errors[0] - self.slopes @ small


def _log_prior(sizes: np.ndarray, width: float) -> np.ndarray:
    """Return the log prior (m,) of an effect at sizes (m,): its spike, or its slab."""
    return -0.5 * (sizes / width) ** 2 - math.log(width * math.sqrt(2.0 * math.pi))


def _subdivided(sizes: np.ndarray, parts: int) -> np.ndarray:
    """Return a grid (m,) with every interval of `sizes` divided into `parts`."""
    inner = [np.linspace(a, b, parts, endpoint=False) for a, b in itertools.pairwise(sizes)]
    return np.append(np.concatenate(inner), sizes[-1])


def log_t(errors: np.ndarray) -> np.ndarray:
    """Return the log-likelihood (..., 6) of errors (..., 6, q): multivariate Student t with nu = q."""
    # log t_nu(e) = -(nu + q) / 2 log(1 + |e|^2 / nu),  nu = q
    return -errors.shape[-1] * np.log1p((errors**2).mean(axis=-1))


def weights(errors: np.ndarray) -> np.ndarray:
    """Return the robust weights (..., 6) of the axes by that t distribution at errors (..., 6, q)."""
    # w = (nu + q) / (nu + |e|^2),  nu = q
    return 2.0 / (1.0 + (errors**2).mean(axis=-1))


def inflation(errors: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Return the variance inflation (6,) by correlated samples of an axis and correlated axes of a landing.

    errors (n, 6, q) at the best point of all grids, slopes (n, 6, q, P): the Jacobian.
    """
    # Empirical over model variance of the scores s = J'w e (as in a sandwich estimator): within an axis
    # max_p sum_i s_ip^2 / sum_i (J'wJ)_ip; then likewise of whole landings, mean over the effects p.
    weight = weights(errors)[..., None]
    score = weight * np.einsum("icq,icqp->icp", errors, slopes)
    known = weight * np.einsum("icqp,icqp->icp", slopes, slopes)
    ratio = (score**2).sum(axis=0) / np.maximum(known.sum(axis=0), 1e-12)
    own = np.maximum(1.0, ratio.max(axis=1))
    landing = (score / own[:, None]).sum(axis=1)
    ratio = (landing**2).sum(axis=0) / np.maximum((known / own[:, None]).sum(axis=(0, 1)), 1e-12)
    return own * max(1.0, float(ratio.mean()))


def common_residual_p_value(landings: Sequence[Landing], residual: np.ndarray, inflated: np.ndarray) -> float:
    """Return the p-value of a common residual of the landings on the same surface, Bonferroni over axes.

    residual (n, 6, q) of a set; inflated (6,): the variance inflation.
    """
    # Score test of a component common to all landings, in the COMMON_MODES largest eigenvectors V of the
    # contact model error (scaled by their standard deviations), a = V'wV, h = V'w e:
    #   h' (a + a a)^-1 h ~ chi^2(COMMON_MODES),  a + a^2 the variance of h by noise and by model error.
    weight, q, values = weights(residual) / inflated, residual.shape[2], []
    sizes, shapes = np.linalg.eigh(landings[0].by_model[:, :q, :q])
    ways = (shapes * np.sqrt(np.maximum(sizes, 0.0))[:, None])[:, :, -COMMON_MODES:]  # (6, q, MODES)
    on_platform = np.array([x.on_platform for x in landings])
    for own in (on_platform, ~on_platform):
        if own.sum() < 2:
            continue
        whiten = np.stack([x.whiten[:, :q, :q] for x in landings])[own]
        slopes = whiten @ ways
        a = np.einsum("ic,icqp,icqs->cps", weight[own], slopes, slopes)
        h = np.einsum("ic,icqp,icq->cp", weight[own], slopes, residual[own])
        squares = (h * np.linalg.solve(a + a @ a, h[..., None])[..., 0]).sum(axis=1)
        values.append(chdtrc(COMMON_MODES, squares))
    return float(min(1.0, np.min(values) * np.size(values)))
