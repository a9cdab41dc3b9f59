"""The stopping rule of a training run: its steps, or a success rate in the evaluations of `evaluation.py`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from inclined_landing.envs.tasks.base import VEHICLE_KINDS, kind_column
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.curriculum import Curriculum

COMPLETE = 1.0 - 1e-9  # level of a curriculum that is complete
# Plateau: the mean of the second half of PATIENCE evaluations exceeds that of the first by less than RISING.
PATIENCE, RISING = 4, 0.01
CLOSE = 0.005  # success this close to the desired one is left to rise by itself


@dataclasses.dataclass(frozen=True)
class Ending:
    """The stopping rule of a run with a resolved configuration.

    least_steps: the number of environment steps before which it does not end by success.
    history, evaluations: the run's lists of rows, which grow as it is trained.
    """

    config: TrainConfig
    least_steps: int
    curriculum: Curriculum
    history: list[dict]
    evaluations: list[dict]

    def is_over(self, steps: int) -> bool:
        """Return whether the run ends after this number of steps."""
        return self.reached(steps) or steps >= self.config.most_steps()

    def reached(self, steps: int) -> bool:
        """Return whether the run has reached the desired success rate and its minimum number of steps.

        A randomised run must reach it with the nominal vehicle and with varied ones. There may be no policy
        that lands all of these, so after some restarts of the learning rate it is sufficient that the rate
        has stopped rising.
        """
        if self.config.success is None or steps < self.least_steps:
            return False
        # A plateau stands for success with varied vehicles, never for that with the nominal one.
        plateau = self.curriculum.restarts >= self.curriculum.most_restarts and self._rises_no_more()
        return self._succeeds(["nominal"] if plateau else VEHICLE_KINDS)

    def has_stalled(self) -> bool:
        """Return whether evaluations have stopped rising before they reach the desired success rate."""
        return self.config.success is not None and not self._succeeds(VEHICLE_KINDS) and self._rises_no_more()

    def should_explore(self) -> bool:
        """Return whether evaluations have stopped rising well below the desired success rate.

        Only those after the curriculum's last rise of the exploration noise count.
        """
        if self.config.success is None or self.evaluations[-1]["score"] >= self.config.success - CLOSE:
            return False
        since = self.curriculum.explored_at
        return _have_stopped_rising([e["score"] for e in self.evaluations if e["steps"] > since])

    def words(self, steps: int, last: str) -> str:
        """Return a sentence on how the run ended after these steps; last: its last evaluation in words."""
        config = self.config
        if config.success is None:
            over = self.is_over(steps)  # whole iterations: a few steps more than those asked for
            return f"ended after {steps} steps" if over else f"stopped after {steps} of {config.steps} steps"
        twice = f"two evaluations in a row at {100 * config.success:g} %"
        asked = twice if config.randomise is None else f"{twice} with the nominal and with varied vehicles"
        if self.reached(steps) and self._succeeds(VEHICLE_KINDS):
            return f"{asked} after {steps} steps"
        if self.reached(steps):
            varied = f"no further rise with varied ones ({100 * self.evaluations[-1]['score_varied']:.0f} %)"
            return f"{twice} with the nominal vehicle and {varied} after {steps} steps"
        most = f" of at most {config.max_steps}" if not self.is_over(steps) else ""
        level = f"the curriculum was at level {self.curriculum.level:.2f}"
        return f"ended without {asked}: after {steps} steps{most} the last one gave {last}, and {level}"

    def _succeeds(self, kinds: Iterable[str]) -> bool:
        """Return whether the last two evaluations, both after the curriculum, reach the desired success rate.

        kinds: vehicles for which they must reach it in a randomised run, keys of VEHICLE_KINDS.
        """
        config, last = self.config, self.evaluations[-2:]
        if len(last) < 2:
            return False
        complete = {row["steps"] for row in self.history if row["level"] >= COMPLETE}
        columns = ["score"] if config.randomise is None else [kind_column("score", kind) for kind in kinds]
        return all(e["steps"] in complete and min(e[c] for c in columns) >= config.success for e in last)

    def _rises_no_more(self) -> bool:
        """Return whether the last evaluations at the lowest learning rate have stopped rising."""
        settled = [e for e in self.evaluations if self.curriculum.may_plateau(e["steps"])]
        return _have_stopped_rising([e["score"] for e in settled])


def _have_stopped_rising(scores: list[float]) -> bool:
    """Return whether the last PATIENCE scores, if there are so many, have stopped rising."""
    last, half = scores[-PATIENCE:], PATIENCE // 2
    return len(last) == PATIENCE and sum(last[half:]) <= sum(last[:half]) + half * RISING
