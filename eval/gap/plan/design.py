"""The choice of a flight: pieces drawn at random, put together by what they tell, and refined one by one."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from inclined_landing.eval.gap.plan import pieces, safety
from inclined_landing.eval.gap.plan.coverage import RegressorCoverage
from inclined_landing.eval.gap.plan.information import Hypothesis, ModelDiscrimination, NoiseLevels
from inclined_landing.eval.gap.plan.pieces import Path, Piece, Space
from inclined_landing.eval.gap.plan.safety import Violation
from inclined_landing.eval.gap.plan.setpoints import Setpoints, setpoints
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle

SECONDS = 20.0
PIECES_PER_KIND = 8  # safe pieces of every kind
DRAWS_PER_PIECE = 40  # draws for one that is safe
REFINEMENT_ROUNDS = 3  # of refinement, each piece moved so often in each, by steps that shrink
MOVES = 4
STEPS = (0.25, 0.12, 0.06)
ATTEMPTS = 6  # flights simulated before giving up
MOST_OF_A_KIND = (
    3  # pieces of a kind, at most: what else may be missing shows in flights that are not all alike
)
MOST_SETS = 12  # the most probable sets that are told apart,
LEAST_SHARE = 0.01  # none of them less probable than this share of the first
SIMULATED = 6  # the most probable of these that the flight is simulated under


@dataclasses.dataclass(frozen=True)
class Plan:
    """A safe flight and what it is expected to tell."""

    points: Setpoints
    discrimination: ModelDiscrimination
    coverage: RegressorCoverage
    expected: np.ndarray  # (K, K) probability of every set j after the flight where the set i is true
    gain: float  # nat, expected decrease of the entropy of the sets
    trajectories: list[np.ndarray]  # states (copies, m, 13) of the simulated flights, by set
    refused: tuple[Violation, ...]  # of flights that were simulated before and not safe

    @property
    def path(self) -> Path:
        """Where it goes."""
        return self.points.path

    @property
    def expected_accuracy(self) -> float:
        """Expected probability of the right set afterwards."""
        return float(self.discrimination.probabilities @ np.diag(self.expected))


def design(
    hypotheses: Sequence[Hypothesis],
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
    """The flight of `seconds` that is expected to tell most about which set of effects `vehicle` lacks.

    quiet: noise and disturbance of the flights at hand. broadly: what an unexplained residual depends on,
    which the flight varies too (see `RegressorCoverage`). platform: the vehicle file's slab is there.
    tick: called as the work goes on. The same arguments give the same plan.
    Raises UserError when there is no room, the battery does not last, or no safe flight is found.
    """
    space = Space.of(vehicle, platform)
    if (voltage := safety.battery_voltage(vehicle, seconds)) < safety.LEAST_VOLTAGE:
        raise UserError(
            f"after {seconds:g} s the vehicle file's battery is at {voltage:.2f} V; plan a shorter flight"
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
            return Plan(points, discrimination, coverage, expected, gain, trajectories, tuple(refused))
        refused.append(violation)
        search.exclude(path, violation.time)
    raise UserError(
        f"none of {ATTEMPTS} flights planned is safe under every set of effects: the last "
        f"{refused[-1].text} after {refused[-1].time:.1f} s"
    )


def probable_sets(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The sets that a flight is planned for, most probable first."""
    ranked = sorted(hypotheses, key=lambda h: -h.probability)[:MOST_SETS]
    return [h for h in ranked if h.probability >= LEAST_SHARE * ranked[0].probability]


def most_informative_piece(
    discrimination: ModelDiscrimination, space: Space, seconds: float = SECONDS
) -> tuple[Piece, np.ndarray]:
    """The one kind of piece that tells most when repeated for so long, and (K, K) what is expected of it.

    Each kind is looked at once, halfway within its bounds: half a second for all of them.
    """
    none = RegressorCoverage((), space, discrimination.noise_levels.noise)
    search = _Search(discrimination, none, space, seconds, np.random.default_rng(0), drawn=0)
    best = max(search.pool, key=lambda piece: discrimination.gain(search.repeated(piece)))
    return best, discrimination.expected(search.repeated(best))


class _Search:
    """Pieces with their matrices, and how a flight is put together from them."""

    def __init__(
        self, discrimination, coverage, space: Space, seconds: float, rng, drawn: int = PIECES_PER_KIND
    ):
        self.discrimination, self.coverage, self.space = discrimination, coverage, space
        self.seconds, self.rng = seconds, rng
        self._information: dict[Piece, tuple[np.ndarray, np.ndarray] | None] = {}
        self.pool = [p for kind in pieces.kinds(space) for p in self._safe_pieces(kind, drawn)]
        self._add_information(self.pool)

    def _safe_pieces(self, kind: str, drawn: int) -> list[Piece]:
        """Safe pieces of a kind: that halfway within its bounds, and so many drawn; fewer where few are."""
        found = [pieces.midpoint(kind)] if self._safe_setpoints(pieces.midpoint(kind)) is not None else []
        for _ in range(DRAWS_PER_PIECE * drawn):
            if len(found) > drawn:
                break
            piece = pieces.draw(kind, self.rng)
            if self._safe_setpoints(piece) is not None:
                found.append(piece)
        return found

    def _safe_setpoints(self, piece: Piece) -> Setpoints | None:
        points = setpoints(pieces.single_path(piece, self.space), self.space.vehicle)
        return points if safety.plan_violation(points, self.space) is None else None

    def _add_information(self, candidates: Sequence[Piece]) -> None:
        """Matrices of pieces not seen before; None where they are not safe."""
        new = [p for p in dict.fromkeys(candidates) if p not in self._information]
        with ThreadPoolExecutor(2) as pool:
            self._information |= dict(zip(new, pool.map(self._gram, new)))

    def _gram(self, piece: Piece) -> tuple[np.ndarray, np.ndarray] | None:
        points = self._safe_setpoints(piece)
        if points is None:
            return None
        flight = self.discrimination.flight(points, platform=self.space.platform)
        return self.discrimination.gram(flight), self.coverage.gram(flight)

    def gain(self, chosen: Sequence[Piece]) -> float:
        """What the pieces tell together [nat], of the sets and of the rest; -1 where one is not safe."""
        grams = [g for p in chosen if (g := self._information[p]) is not None]
        if len(grams) < len(chosen):
            return -1.0
        of_sets, of_rest = (np.sum(g, axis=0) for g in zip(*grams))
        return self.discrimination.gain(of_sets) + self.coverage.gain(of_rest)

    def repeated(self, piece: Piece) -> np.ndarray:
        """Matrix (P, P) of a piece of the pool flown again and again until time is up."""
        times = self.seconds / pieces.single_path(piece, self.space).seconds
        grams = self._information[piece]
        assert grams is not None  # pieces of the pool are safe
        return times * grams[0]

    def best(self) -> Path:
        """The pieces of the pool that tell most together, refined, as one flight."""
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
        """One piece after the other, that which gains most for its time, until time is up.

        Beside more others a piece hardly ever gains more: those that gained too little before are not looked
        at again (lazy greedy choice, Minoux 1978).
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
        """Whether the pieces fit in the time and are safe with the ways between them."""
        path = pieces.joined_path(chosen, self.space)
        if path.seconds > self.seconds:
            return False
        return safety.plan_violation(setpoints(path, self.space.vehicle), self.space) is None

    def exclude(self, path: Path, time: float) -> None:
        """Leave out, from now on, the piece flown at a time, or the next one."""
        for span in path.spans:
            if time < span.stop + 0.5:
                kind = span.piece.kind
                own = np.array(span.piece.shares)
                # Those like it too.
                self.pool = [
                    p for p in self.pool if p.kind != kind or np.abs(np.array(p.shares) - own).max() > 0.25
                ]
                self._information[span.piece] = None
                return
