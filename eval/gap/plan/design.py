"""Bayesian experiment design: random pieces of flight, chosen greedily by information gain, then refined."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from inclined_landing.eval.gap.plan import SECONDS, pieces, safety
from inclined_landing.eval.gap.plan.information import ModelDiscrimination, ScoredSet
from inclined_landing.eval.gap.plan.pieces import Path, Piece, Setpoints, Space, setpoints
from inclined_landing.eval.gap.plan.reading import PlanInput
from inclined_landing.eval.gap.plan.safety import Flown
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.threads import two_at_a_time

PIECES_PER_KIND = 8  # random safe pieces of every kind
DRAWS_PER_PIECE = 40  # at most, for one that is safe
MOVES = 4  # random perturbations of a piece in each round of refinement
STEPS = (0.25, 0.12, 0.06)  # their size in each round, shares of the bounds
ATTEMPTS = 6  # flights simulated before giving up
MOST_OF_A_KIND = 3  # pieces of a kind: varied flights also excite what is not in the library
MOST_SETS = 12  # most probable sets that are discriminated between
LEAST_SHARE = 0.01  # of the first one's probability, for the others
SIMULATED = 6  # most probable sets under which the flight is simulated
WORTH = 0.2  # pieces near a surface, and turns, are flown only if they add at least this share of the gain
NEAR_KEPT = 0.9  # share of what they add to the right set's expected probability that is kept when raised
RAISED = (1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)  # heights tried, shares of their bounds


@dataclasses.dataclass(frozen=True)
class Plan:
    """A safe flight and its expected information, in the closed loop that it is flown in."""

    points: Setpoints
    discrimination: ModelDiscrimination
    expected: np.ndarray  # (K, K) expected posterior probability of every set j where the set i is true
    gain: float  # nat, expected information gain: decrease of the entropy of the sets
    flown: list[Flown]  # the simulated flights, by set
    without: np.ndarray | None  # (K, K) expected without pieces close to a surface; None where it has none

    @property
    def path(self) -> Path:
        """Return the flight's path."""
        return self.points.path

    @property
    def trajectories(self) -> list[np.ndarray]:
        """Return the states (copies, m, 13) of the simulated flights, by set."""
        return [one.states for one in self.flown]

    @property
    def expected_accuracy(self) -> float:
        """Return the expected posterior probability of the true set."""
        return float(self.discrimination.probabilities @ np.diag(self.expected))


@threadpool_limits.wrap(limits=1, user_api="blas")  # many small matrices, in threads of our own
def design(
    plan_input: PlanInput,
    *,
    seconds: float = SECONDS,
    tick: Callable[[str], None] = lambda what: None,
) -> Plan:
    """Return the safe flight with the largest expected information about which set of effects is missing.

    tick: called with every stage. The same arguments give the same plan. Raises UserError when there is no
    room, the battery does not last, or no safe flight is found.
    """
    vehicle = plan_input.vehicle
    space = Space.of(vehicle, plan_input.platform)
    if (voltage := safety.battery_voltage(vehicle, seconds)) < safety.LEAST_VOLTAGE:
        raise UserError(
            f"after {seconds:g} s the battery of the vehicle file is at {voltage:.2f} V; "
            "plan a shorter flight"
        )
    noise_levels, known = plan_input.noise_levels, probable_sets(plan_input.hypotheses)
    discrimination = ModelDiscrimination(known, vehicle, noise_levels, plan_input.reference)
    tick("drawing manoeuvres")
    search = _Search(discrimination, space, seconds, np.random.default_rng(0))
    last = ""
    for _ in range(ATTEMPTS):
        tick("choosing manoeuvres")
        chosen, far = search.best()
        path = pieces.joined_path(chosen, space, seconds)
        points = setpoints(path, vehicle)
        tick("simulating the planned flight")
        vehicles = discrimination.vehicles[:SIMULATED]
        violation, flown = safety.simulate_plan(points, vehicles, space, noise_levels)
        if violation is None:
            tick("computing the expected information")
            logs = [one.log(noise_levels.noise) for one in flown]
            grams = discrimination.flown_grams(logs, platform=plan_input.platform)
            expected, gain = discrimination.forecast(grams), discrimination.gain(grams)
            without = None if far is None else discrimination.forecast(far)
            return Plan(points, discrimination, expected, gain, flown, without)
        last = f"{violation.text} after {violation.time:.1f} s"
        search.exclude(path, violation.time)
    raise UserError(f"none of {ATTEMPTS} planned flights is safe under every set of effects; the last {last}")


def probable_sets(hypotheses: Sequence[ScoredSet]) -> list[ScoredSet]:
    """Return the sets that a flight discriminates between, most probable first."""
    ranked = sorted(hypotheses, key=lambda h: -h.probability)[:MOST_SETS]
    return [h for h in ranked if h.probability >= LEAST_SHARE * ranked[0].probability]


class _Search:
    """Greedy search over sequences of pieces with their Gram matrices."""

    def __init__(self, discrimination: ModelDiscrimination, space: Space, seconds: float, rng):
        self.discrimination, self.space = discrimination, space
        self.seconds, self.rng = seconds, rng
        self.turning = True  # may the pieces turn the nose
        self._information: dict[Piece, np.ndarray | None] = {}
        found = [p for kind in pieces.kinds(space) for p in self._safe_pieces(kind)]
        # Every other piece keeps the nose where it is: a choice without turns has as many to choose from.
        held = [p.steady if k % 2 else p for k, p in enumerate(found)]
        self.pool = [p for p in dict.fromkeys(held) if p and self._safe_setpoints(p)]
        self._add_information(self.pool)

    def _safe_pieces(self, kind: str) -> list[Piece]:
        """Return safe pieces of a kind: the midpoint of its bounds, and random ones."""
        found = [pieces.midpoint(kind)] if self._safe_setpoints(pieces.midpoint(kind)) else []
        for _ in range(DRAWS_PER_PIECE * PIECES_PER_KIND):
            if len(found) > PIECES_PER_KIND:
                break
            if self._safe_setpoints(piece := pieces.draw(kind, self.rng)):
                found.append(piece)
        return found

    def _safe_setpoints(self, piece: Piece) -> Setpoints | None:
        """Return the set-points of a piece flown alone; None where it is not safe."""
        points = setpoints(pieces.single_path(piece, self.space), self.space.vehicle)
        return points if safety.plan_violation(points, self.space) is None else None

    def _add_information(self, candidates: Sequence[Piece]) -> None:
        """Compute the Gram matrices of new pieces."""
        new = [p for p in dict.fromkeys(candidates) if p not in self._information]
        self._information |= dict(zip(new, two_at_a_time(self._gram, new)))

    def _gram(self, piece: Piece) -> np.ndarray | None:
        """Return the Gram matrix of a piece; None where it is not safe."""
        points = self._safe_setpoints(piece)
        if points is None:
            return None
        return self.discrimination.gram(self.discrimination.flight(points, platform=self.space.platform))

    def _gram_of(self, chosen: Sequence[Piece]) -> np.ndarray | None:
        """Return the Gram matrix (P, P) of some pieces, which add up; None where one is not safe."""
        grams = [g for p in chosen if (g := self._information[p]) is not None]
        nothing = np.zeros(2 * self.discrimination.free.shape[1:])
        return np.sum([nothing, *grams], axis=0) if len(grams) == len(chosen) else None

    def gain(self, chosen: Sequence[Piece]) -> float:
        """Return the information gain [nat] of pieces about the sets; -1 where one is not safe, or none."""
        gram = self._gram_of(chosen)
        return -1.0 if gram is None or not chosen else self.discrimination.gain(gram)

    def best(self) -> tuple[list[Piece], np.ndarray | None]:
        """Return the pieces of the largest information gain: greedy choice, then random local search.

        Turns and headings, and pieces close to a surface, are among them only where they are needed: what a
        flight shows in addition to what is in doubt creates new doubt. Pieces close to a surface are not
        lower than needed; if there are any, returns also the Gram matrix (P, P) of the best flight without.
        """
        every, self.turning = self._greedy_choice(self.pool), True
        held = [p for p in self.pool if p.steady == p]
        steady = self._greedy_choice(held)
        if not self._worth(every, steady):
            every, self.turning = steady, False
        chosen = self._refined(every)
        if not any(p.near for p in chosen):
            return chosen, None
        far = self._greedy_choice([p for p in (self.pool if self.turning else held) if not p.near])
        if not self._worth(chosen, far):
            return self._refined(far), None
        return self._raised(chosen), self._gram_of(far)

    def _worth(self, more: Sequence[Piece], less: Sequence[Piece]) -> bool:
        """Return whether one choice of pieces is worth flying because it is so much more informative."""
        return self.gain(more) - max(0.0, self.gain(less)) > WORTH * self.gain(more)

    def _refined(self, chosen: list[Piece]) -> list[Piece]:
        """Return the pieces after random steps of their parameters that raise the gain."""
        for step in STEPS:
            for k in range(len(chosen)):
                moved = [pieces.perturbed(chosen[k], self.rng, step) for _ in range(MOVES)]
                if not self.turning:
                    moved = [p for piece in moved if (p := piece.steady) is not None]
                chosen = self._better(chosen, k, moved)
        return chosen

    def _better(self, chosen: list[Piece], k: int, moved: Sequence[Piece]) -> list[Piece]:
        """Return the pieces with the k-th replaced by the best feasible of `moved` that raises the gain."""
        self._add_information(moved)
        others = [[*chosen[:k], p, *chosen[k + 1 :]] for p in moved]
        better = [c for c in others if self.gain(c) > self.gain(chosen)]
        better.sort(key=self.gain, reverse=True)
        return next(filter(self._feasible, better), chosen)

    def _raised(self, chosen: list[Piece]) -> list[Piece]:
        """Return the pieces, those close to a surface as high as still discriminates between the sets."""
        far = self._told([p for p in chosen if not p.near])
        enough = far + NEAR_KEPT * (self._told(chosen) - far)
        for k, piece in enumerate(chosen):
            if not piece.near:
                continue
            raised = [p for share in RAISED if (p := piece.at_height(share)).height > piece.height]
            self._add_information(raised)
            others = [[*chosen[:k], p, *chosen[k + 1 :]] for p in raised]
            chosen = next((c for c in others if self._told(c) >= enough and self._feasible(c)), chosen)
        return chosen

    def _told(self, chosen: Sequence[Piece]) -> float:
        """Return what a flight adds to the right set's expected probability; -1 where it is not safe."""
        if not chosen:
            return 0.0
        gram, p = self._gram_of(chosen), self.discrimination.probabilities
        return -1.0 if gram is None else float(p @ (np.diag(self.discrimination.forecast(gram)) - p))

    def _greedy_choice(self, pool: Sequence[Piece]) -> list[Piece]:
        """Return pieces added by their gain per second until time is up (lazy greedy, Minoux 1978).

        The gain is nearly submodular: a piece's earlier rate bounds its present one.
        """
        chosen: list[Piece] = []
        gain, taken = 0.0, pieces.joined_path([], self.space).seconds
        candidates = [(math.inf, piece) for piece in pool]
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
