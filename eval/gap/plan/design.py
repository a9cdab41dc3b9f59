"""Bayesian experiment design: random pieces of flight, chosen greedily by information gain, then refined."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from inclined_landing.eval.gap.plan import pieces, safety
from inclined_landing.eval.gap.plan.coverage import RegressorCoverage
from inclined_landing.eval.gap.plan.information import ModelDiscrimination, NoiseLevels, ScoredSet
from inclined_landing.eval.gap.plan.pieces import Path, Piece, Space
from inclined_landing.eval.gap.plan.safety import Violation
from inclined_landing.eval.gap.plan.setpoints import Setpoints, setpoints
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle

SECONDS = 20.0
PIECES_PER_KIND = 8  # random safe pieces of every kind
DRAWS_PER_PIECE = 40  # at most, for one that is safe
MOVES = 4  # random perturbations of a piece in each round of refinement
STEPS = (0.25, 0.12, 0.06)  # their size in each round, shares of the bounds
ATTEMPTS = 6  # flights simulated before giving up
MOST_OF_A_KIND = 3  # pieces of a kind: varied flights also excite what is not in the library
MOST_SETS = 12  # most probable sets that are discriminated between
LEAST_SHARE = 0.01  # of the first one's probability, for the others
SIMULATED = 6  # most probable sets under which the flight is simulated


@dataclasses.dataclass(frozen=True)
class Plan:
    """A safe flight and its expected information."""

    points: Setpoints
    discrimination: ModelDiscrimination
    expected: np.ndarray  # (K, K) expected posterior probability of every set j where the set i is true
    gain: float  # nat, expected information gain: decrease of the entropy of the sets
    trajectories: list[np.ndarray]  # states (copies, m, 13) of the simulated flights, by set
    refused: tuple[Violation, ...]  # of flights that were simulated before and not safe

    @property
    def path(self) -> Path:
        """Return the flight's path."""
        return self.points.path

    @property
    def expected_accuracy(self) -> float:
        """Return the expected posterior probability of the true set."""
        return float(self.discrimination.probabilities @ np.diag(self.expected))


def design(
    hypotheses: Sequence[ScoredSet],
    vehicle: Vehicle,
    *,
    noise_levels: NoiseLevels | None = None,
    vary: Sequence[str] = (),
    seconds: float = SECONDS,
    platform: bool = False,
    library: Mapping[str, Effect] = LIBRARY,
    seed: int = 0,
    tick: Callable[[str], None] = lambda what: None,
) -> Plan:
    """Return the safe flight with the largest expected information about which set of effects is missing.

    noise_levels: of the flights at hand. vary: regressors of an unexplained residual, which the flight varies
    too (see `RegressorCoverage`). platform: the slab of the vehicle file stands there. tick: called with
    every stage. The same arguments give the same plan.
    Raises UserError when there is no room, the battery does not last, or no safe flight is found.
    """
    space = Space.of(vehicle, platform)
    if (voltage := safety.battery_voltage(vehicle, seconds)) < safety.LEAST_VOLTAGE:
        raise UserError(
            f"after {seconds:g} s the battery of the vehicle file is at {voltage:.2f} V; "
            "plan a shorter flight"
        )
    known = probable_sets(hypotheses)
    discrimination = ModelDiscrimination(known, vehicle, noise_levels or NoiseLevels.typical(), library)
    tick("pieces")
    coverage = RegressorCoverage(vary, space, discrimination.noise_levels.noise)
    search = _Search(discrimination, coverage, space, seconds, np.random.default_rng(seed))
    refused: list[Violation] = []
    for _ in range(ATTEMPTS):
        tick("choice")
        path = search.best()
        points = setpoints(path, vehicle)
        tick("simulated flights")
        violation, trajectories = safety.simulate_plan(
            points, discrimination.vehicles[:SIMULATED], space, discrimination.noise_levels, seed
        )
        if violation is None:
            gram = discrimination.gram(discrimination.flight(points, platform=platform))
            expected, gain = discrimination.expected(gram), discrimination.gain(gram)
            return Plan(points, discrimination, expected, gain, trajectories, tuple(refused))
        refused.append(violation)
        search.exclude(path, violation.time)
    raise UserError(
        f"none of {ATTEMPTS} flights planned is safe under every set of effects: the last "
        f"{refused[-1].text} after {refused[-1].time:.1f} s"
    )


def probable_sets(hypotheses: Sequence[ScoredSet]) -> list[ScoredSet]:
    """Return the sets that a flight discriminates between, most probable first."""
    ranked = sorted(hypotheses, key=lambda h: -h.probability)[:MOST_SETS]
    return [h for h in ranked if h.probability >= LEAST_SHARE * ranked[0].probability]


def most_informative_piece(
    discrimination: ModelDiscrimination, space: Space, seconds: float = SECONDS
) -> tuple[Piece, np.ndarray]:
    """Return the piece of the largest information gain when repeated, and the expected posterior (K, K).

    One piece of each kind is tried, at the middle of its bounds: half a second for all of them.
    """
    none = RegressorCoverage((), space, discrimination.noise_levels.noise)
    search = _Search(discrimination, none, space, seconds, np.random.default_rng(0), drawn=0)
    best = max(search.pool, key=lambda piece: discrimination.gain(search.repeated(piece)))
    return best, discrimination.expected(search.repeated(best))


class _Search:
    """Greedy search over sequences of pieces with their Gram matrices."""

    def __init__(
        self, discrimination, coverage, space: Space, seconds: float, rng, drawn: int = PIECES_PER_KIND
    ):
        self.discrimination, self.coverage, self.space = discrimination, coverage, space
        self.seconds, self.rng = seconds, rng
        self._information: dict[Piece, tuple[np.ndarray, np.ndarray] | None] = {}
        self.pool = [p for kind in pieces.kinds(space) for p in self._safe_pieces(kind, drawn)]
        self._add_information(self.pool)

    def _safe_pieces(self, kind: str, drawn: int) -> list[Piece]:
        """Return safe pieces of a kind: the midpoint of its bounds, and up to `drawn` random ones."""
        found = [pieces.midpoint(kind)] if self._safe_setpoints(pieces.midpoint(kind)) is not None else []
        for _ in range(DRAWS_PER_PIECE * drawn):
            if len(found) > drawn:
                break
            piece = pieces.draw(kind, self.rng)
            if self._safe_setpoints(piece) is not None:
                found.append(piece)
        return found

    def _safe_setpoints(self, piece: Piece) -> Setpoints | None:
        """Return the set-points of a piece flown alone; None where it is not safe."""
        points = setpoints(pieces.single_path(piece, self.space), self.space.vehicle)
        return points if safety.plan_violation(points, self.space) is None else None

    def _add_information(self, candidates: Sequence[Piece]) -> None:
        """Compute the Gram matrices of new pieces; None where they are not safe."""
        new = [p for p in dict.fromkeys(candidates) if p not in self._information]
        with ThreadPoolExecutor(2) as pool:
            self._information |= dict(zip(new, pool.map(self._gram, new)))

    def _gram(self, piece: Piece) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the Gram matrices of a piece for the sets and for unknown functions."""
        points = self._safe_setpoints(piece)
        if points is None:
            return None
        flight = self.discrimination.flight(points, platform=self.space.platform)
        return self.discrimination.gram(flight), self.coverage.gram(flight)

    def gain(self, chosen: Sequence[Piece]) -> float:
        """Return the information gain [nat] of pieces about sets and functions; -1 where one is not safe."""
        grams = [g for p in chosen if (g := self._information[p]) is not None]
        if len(grams) < len(chosen):
            return -1.0
        of_sets, of_functions = (np.sum(g, axis=0) for g in zip(*grams))  # information is additive
        return self.discrimination.gain(of_sets) + self.coverage.gain(of_functions)

    def repeated(self, piece: Piece) -> np.ndarray:
        """Return the Gram matrix (P, P) of a piece of the pool repeated until time is up."""
        times = self.seconds / pieces.single_path(piece, self.space).seconds
        grams = self._information[piece]
        assert grams is not None  # pieces of the pool are safe
        return times * grams[0]

    def best(self) -> Path:
        """Return the flight of the largest information gain: greedy choice, then random local search."""
        chosen = self._greedy_choice()
        for step in STEPS:
            for k in range(len(chosen)):
                moved = [pieces.perturbed(chosen[k], self.rng, step) for _ in range(MOVES)]
                self._add_information(moved)
                others = [[*chosen[:k], p, *chosen[k + 1 :]] for p in moved]
                better = [c for c in others if self.gain(c) > self.gain(chosen)]
                better.sort(key=self.gain, reverse=True)
                chosen = next(filter(self._feasible, better), chosen)
        return pieces.joined_path(chosen, self.space, self.seconds)

    def _greedy_choice(self) -> list[Piece]:
        """Return pieces added by their gain per second until time is up (lazy greedy, Minoux 1978).

        The gain is nearly submodular: a piece's earlier rate bounds its present one.
        """
        chosen: list[Piece] = []
        gain, taken = 0.0, pieces.joined_path([], self.space).seconds
        candidates = [(math.inf, piece) for piece in self.pool]
        while True:
            best, rated = None, []
            for promised, piece in sorted(candidates, key=lambda row: -row[0]):
                if best is not None and promised <= best[0]:
                    rated.append((promised, piece))
                    continue
                longer = [*chosen, piece]
                if sum(p.kind == piece.kind for p in longer) > MOST_OF_A_KIND or not self._feasible(longer):
                    continue
                new, seconds = self.gain(longer), pieces.joined_path(longer, self.space).seconds
                rate = (new - gain) / (seconds - taken)
                rated.append((rate, piece))
                if best is None or rate > best[0]:
                    best = rate, new, seconds, longer
            if best is None:
                return chosen
            candidates = rated
            _, gain, taken, chosen = best

    def _feasible(self, chosen: Sequence[Piece]) -> bool:
        """Return whether the pieces fit in the time and are safe with the moves between them."""
        path = pieces.joined_path(chosen, self.space)
        if path.seconds > self.seconds:
            return False
        return safety.plan_violation(setpoints(path, self.space.vehicle), self.space) is None

    def exclude(self, path: Path, time: float) -> None:
        """Exclude the piece flown at a time (or the next one) and similar ones from the pool."""
        for span in path.spans:
            if time < span.stop + 0.5:
                kind = span.piece.kind
                own = np.array(span.piece.shares)
                self.pool = [
                    p for p in self.pool if p.kind != kind or np.abs(np.array(p.shares) - own).max() > 0.25
                ]
                self._information[span.piece] = None
                return
