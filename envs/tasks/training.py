"""The defaults of `landing-train`: one table, with a row for each option and a column for each case.

    landing        one vehicle: --nominal, or platforms that move
    drawn          landing in the plane, a vehicle drawn for every episode: the default
    drawn-from     the same, continued from a policy
    drawn-slopes   the same, with --steepest or --randomise
    drawn-space    the same, with --dimensions 3
    touchdown      in space, which is its default
    touchdown-2d   in the plane
    setpoint       one vehicle

Rules that change values of a column: --nominal means one vehicle, no history and actions around hover;
platforms that move mean one vehicle; a run of a fixed number of steps with drawn vehicles is evaluated every
32 iterations. A run that ends by success takes 300 000 to 3 000 000 steps, or at least 100 000 if it
continues from a policy of its task, whose network, history and action map it then has. In every case networks
have two layers of 64, and rewards are scaled by 0.1. Options that are given replace all of these.
"""

from __future__ import annotations

import ast
import dataclasses
from typing import Annotated, Any

from msgspec import Meta

from inclined_landing.envs.tasks.options import LONGEST_HISTORY, Record
from inclined_landing.models.base.schema import Many, Share
from inclined_landing.models.scene import Zone

# Text, because code would not keep the columns aligned within the width of a line.
_TABLE = """
               landing   drawn     drawn-from  drawn-slopes  drawn-space  touchdown  touchdown-2d    setpoint
steps          None      None      None        None          None         2_000_000  1_500_000       2_000_000
success        0.99      0.99      0.99        0.99          0.99         None       None            None
start_from     None      None      None        None          None         descent    landing-nominal None

randomise      None      robust    robust      robust        robust       robust     None            None
history        0         3         3           3             3            3          0               0
all_commands   False     True      True        True          True         True       False           False

curriculum     adaptive  balanced  adaptive    adaptive      adaptive     touchdown  touchdown       effort
learning_rate  2e-3      2e-3      2e-3        2e-3          1e-3         3e-4       4e-4            2e-3
log_std_init   -0.4      -0.4      -0.4        -0.4          -0.4         -2.2       -1.2            -0.4
gamma          0.98      0.99      0.98        0.98          0.98         0.998      0.99            0.97
gae_lambda     0.95      0.85      0.85        0.95          0.95         0.95       0.95            0.95
environments   64        128       128         64            64           128        64              64
rollout        64        32        32          64            128          128        128             64
batch_size     256       256       256         256           256          1024       512             256
epochs         5         5         5           5             5            5          5               8
evaluate_every 16        8         16          16            16           16         16              16
"""
# Reasons for some of the values:
#   steps: of the touchdown, after one million one of ten seeds loses starts at the edge of the room; of the
#       set-point, four of ten leave some starts 7 to 9 cm off.
#   gae_lambda: with 0.95 half a million steps land 78 % of the drawn vehicles, with 0.85 84 % (means of four
#       seeds).
#   gamma of drawn vehicles: a landing takes up to 150 steps. With 0.98 its return from afar is hardly higher
#       than that of hovering for good, and one of ten seeds hovered 2 m from the goal, on one side of it.
#   rollout, learning_rate in space: vehicles differ in more than in the plane; with its rates one of three
#       seeds learned the landing.
#   history of the touchdown: over moving platforms it shows the platform's motion.
#   log_std_init of the touchdown: with more noise what the feedback law taught is lost. In the plane it
#       begins with a landing policy instead, and explores more.
#   gamma of the touchdown: a long discount, or the vehicle comes in too fast.


@dataclasses.dataclass(frozen=True)
class Training(Record):
    """Defaults for the options of `landing-train` with the same names, and how vehicles are simulated.

    The values here are those of custom tasks.
    """

    steps: Many | None = 1_000_000
    """Fixed number of environment steps; None: the run ends by success."""
    success: Share | None = None
    """Success rate that ends the run when two evaluations in a row reach it."""
    min_steps: Annotated[int, Meta(ge=0, le=10**9)] = 300_000
    """Minimum number of environment steps of a run that ends by success."""
    max_steps: Many = 3_000_000
    """Maximum number of environment steps of a run that ends by success."""
    start_from: str | None = None
    """Policy to start from: a file, a shipped name, or the feedback law `descent`."""
    randomise: str | None = None
    """Ranges from which every episode's vehicle is drawn."""
    history: Annotated[int, Meta(ge=0, le=LONGEST_HISTORY)] = 0
    """Number of past steps in the policy's input."""
    all_commands: bool = False
    """Whether actions reach every PWM, as some vehicles need, or those around hover."""
    curriculum: str = "none"
    """Name of the curriculum, one of the task's `curricula`."""
    learning_rate: Annotated[float, Meta(gt=0, lt=1)] = 1e-3
    """Initial learning rate; the curriculum determines its decay."""
    log_std_init: Annotated[float, Meta(ge=-10, le=2)] = -0.4
    """Logarithm of the initial exploration noise."""
    gamma: Annotated[float, Meta(gt=0, lt=1)] | str = 0.99
    """Discount factor, or "paper": rising from 0.97 to 0.99 over 800 000 steps."""
    gae_lambda: Share = 0.95
    """Lambda of the generalised advantage estimate."""
    environments: Annotated[int, Meta(ge=1, le=16_384)] = 64
    """Number of vehicles simulated in parallel."""
    rollout: Annotated[int, Meta(ge=1, le=65_536)] = 128
    """Steps of each vehicle between two updates of PPO."""
    batch_size: Annotated[int, Meta(ge=2, le=10**9)] = 512
    """Samples in a minibatch, at most a whole rollout."""
    epochs: Annotated[int, Meta(ge=1, le=1000)] = 5
    """Passes over each rollout."""
    evaluate_every: Annotated[int, Meta(ge=0, le=10**9)] = 16
    """Iterations between evaluations, 0 for none."""
    keep_out: Zone = 0.04
    """Width of a contact-free zone around the platform that counts as an obstacle in training [m]."""
    integrator: str = "implicitfast"
    """Integrator of the engine in training, with steps of 4 ms."""


def _cell(text: str) -> Any:
    try:
        return ast.literal_eval(text)
    except (SyntaxError, ValueError):  # a name
        return text


def _columns() -> dict[str, Training]:
    (cases, *rows) = (line.split() for line in _TABLE.splitlines() if line)
    columns = zip(*([_cell(text) for text in values] for _, *values in rows), strict=True)
    names = [name for name, *_ in rows]
    return {case: Training(**dict(zip(names, column))) for case, column in zip(cases, columns, strict=True)}


DEFAULTS: dict[str, Training] = _columns()


def in_case(training: Training, usual: str, case: str) -> Training:
    """Return a task's training with the values in which the column `case` differs from `usual`, the task's.

    A custom task that derives from a shipped one may have its own training: values other than the defaults
    stay. One that it states and that equals the default counts as left out.
    """
    before, values, plain = vars(DEFAULTS[usual]), vars(DEFAULTS[case]), vars(Training())
    changes = {
        name: value
        for name, value in values.items()
        if value != before[name] and getattr(training, name) in (before[name], plain[name])
    }
    return dataclasses.replace(training, **changes)
