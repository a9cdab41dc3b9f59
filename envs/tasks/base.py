"""The interface of tasks: observation, action map, starts, reward, and what evaluation needs.

A task holds no vehicle state and steps nothing. `BatchEnv` owns the plant and the episodes and asks
the task; every function here takes and returns arrays whose first axis is the vehicle.

A new task is a class derived from `Task`: in a file next to this one with its entry in `TASK_CLASSES`
(`envs/ids.py`), or anywhere and named as `module:Class` or `file.py:Class` (`envs.tasks.own`). It must have
`name`, the names and scale of its observations, `action_names`, `sample` and `evaluate`; everything else has
a default: it can then be trained, evaluated, filmed and pictured.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import inspect
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numba
import numpy as np

from inclined_landing.envs.tasks.options import TaskOptions, Training
from inclined_landing.envs.tasks.start import Start
from inclined_landing.models.attitude import (
    COMMAND_SIZE,
    LAG,
    PITCH_COMMAND,
    PWM,
    ROLL_COMMAND,
    STATE_NAMES,
    STATE_SIZE,
    YAW_RATE_COMMAND,
)
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.forces import settled_hover
from inclined_landing.models.parameters import as_vehicle, constants
from inclined_landing.models.plants import Contacts
from inclined_landing.models.vehicle import Vehicle

COLUMNS = {name: column for column, name in enumerate(STATE_NAMES)}  # of the state
ACTIONS = {"thrust": PWM, "roll": ROLL_COMMAND, "pitch": PITCH_COMMAND, "yaw rate": YAW_RATE_COMMAND}
_UNKNOWN: Any = None
FARTHEST = 1e4  # largest entry of a start state, SI units: beyond, the engine diverges
OWN = "own"  # PWM at action 0: the hover of each vehicle that is flown


@dataclasses.dataclass(frozen=True)
class StepContext:
    """What observation and reward of n vehicles are computed from, after one control step.

    `observe` is given the state as motion capture reports it, the contacts and the platforms; `evaluate` is
    given everything, with the true state.
    """

    state: np.ndarray  # (n, 13)
    contacts: Contacts = _UNKNOWN  # of the last control step
    actions: np.ndarray = _UNKNOWN  # (n, a) in [-1, 1] that led here
    start: Start = _UNKNOWN  # of the running episodes
    length: np.ndarray = _UNKNOWN  # (n,) steps of the episode so far, the last one included
    in_contact: np.ndarray = _UNKNOWN  # (n,) of them, steps in contact with the platform
    held_steps: np.ndarray = _UNKNOWN  # (n,) consecutive held steps before the last one
    platform: np.ndarray = _UNKNOWN  # (n, 12) states of the platforms, see `Plant.set_platform`


@dataclasses.dataclass(frozen=True)
class Channel:
    """The command of one action a: centre + span a, clipped to low .. high, and 0 up to action `idle`."""

    name: str  # of the action
    column: int  # of the plant commands
    centre: float  # in the unit of the column, `attitude.COMMAND_UNITS`
    span: float
    low: float
    high: float
    idle: float | None = None


@dataclasses.dataclass
class Evaluation:
    """Reward terms and end of one step; the reward is the sum of the terms."""

    terms: dict[str, np.ndarray]  # name -> (n,)
    success: np.ndarray  # (n,) bool
    terminated: np.ndarray = _UNKNOWN  # (n,) bool; by default with success
    cut: np.ndarray = _UNKNOWN  # (n,) bool: does training truncate the episode; by default never
    holding: np.ndarray | None = None  # (n,) bool: does this step count as held; None: the task has no hold

    def __post_init__(self):
        self.terminated = self.success if self.terminated is None else self.terminated
        self.cut = np.zeros(len(self.success), bool) if self.cut is None else self.cut

    @property
    def reward(self) -> np.ndarray:
        """(n,) sum of the terms."""
        return sum(self.terms.values(), np.zeros(len(self.success)))


_NO_CENTRES = np.empty(0)


@numba.njit(cache=True)
def _commands(actions, channels, pwm_centres):
    """Return `Task.commands` of channels (a, 6); pwm_centres (n,), or empty."""
    out = np.zeros((len(actions), COMMAND_SIZE))
    for k in range(len(channels)):
        column, centre = int(channels[k, 0]), channels[k, 1]
        span, low, high, idle = channels[k, 2], channels[k, 3], channels[k, 4], channels[k, 5]
        given = column == PWM and len(pwm_centres) > 0
        for i in range(len(actions)):
            if actions[i, k] > idle:
                middle = pwm_centres[i] if given else centre
                out[i, column] = min(high, max(low, middle + span * actions[i, k]))
    return out


# Scored apart in a randomised run.
VEHICLE_KINDS = {"nominal": "nominal vehicle", "varied": "varied vehicles"}


@dataclasses.dataclass(frozen=True)
class ScoreCurve:
    """How the learning curves plot an entry of `Task.score`."""

    column: str = "score"
    label: str = "success [%]"
    factor: float = 100.0
    limits: tuple[float, float] | None = (-3.0, 108.0)
    reference: tuple[float, str] | None = None  # value and what it is
    logarithmic: bool = False


class Task(abc.ABC):
    """A task for vehicles of one kind. Everything but the first four and the two methods has a default.

    `settings` are the options as they were given, `options` those of them that a policy file carries:
    `make_task(name, **options)` builds the task again. `history` is how many past steps its policy is given
    besides the observation, `observe_vehicle` whether it is given the numbers of its vehicle
    (`envs.history`); `conditions` is what a curriculum may ease, None where there is nothing to ease.
    """

    name: str
    reward_weights: Mapping[str, float] = MappingProxyType({})  # of the terms, where a task names them
    observation_names: tuple[str, ...]
    observation_scale: np.ndarray  # typical size of each observation
    action_names: tuple[str, ...]  # of: thrust, roll, pitch, yaw rate

    options_type: type[TaskOptions] = TaskOptions
    settings: TaskOptions
    max_steps = 300
    has_platform = False
    is_planar = False  # does the vehicle fly in the plane y = 0
    observes_slope = False  # is everything observed from the platform, and its slope too
    platform_moves = False
    inclination = 0.0  # of the platform where no other is drawn or given, rad
    azimuth = 0.0  # direction that the platform faces there, from +x, rad
    steepest: float | None = None  # largest inclination that is drawn, rad; None: there is one slope
    goal_size: float | None = None  # half width of the goal box, m
    idle_action: float | None = None  # thrust actions up to this one command PWM 0
    cut_at_success = False  # are the motors cut from outside where an episode ends with success
    judged_after: float | None = None  # s that an evaluated flight lasts at most; None: max_steps
    shipped = False  # is a policy of this name shipped
    table = "flights"  # the command or the table that judges its policies, see eval.policies
    # In how many dimensions `landing-train` draws a vehicle for every episode, with a history to tell it by.
    drawn_vehicles: tuple[int, ...] = ()
    training = Training()
    curricula: tuple[str, ...] = ("none",)  # those of train.curriculum that know the task
    training_conditions: Any = None  # conditions of training without a curriculum; None: the task as it is
    score_curve = ScoreCurve()
    start_axes: tuple[str, ...] = ("x", "y", "z")  # what a start is given by
    film_starts: tuple[tuple[float, ...], ...] = ((1.5, 1.0, 0.6),)  # m; the first one is the usual one
    # By name of the file.
    figure_starts: Mapping[str, tuple[float, ...]] = MappingProxyType({"trajectory": film_starts[0]})
    conditions: Any = None

    @classmethod
    def option_names(cls) -> list[str]:
        """Return what the constructor takes: the record's fields, and keywords of one of its own."""
        keywords = inspect.signature(cls).parameters.values()
        added = [parameter.name for parameter in keywords if parameter.kind is parameter.KEYWORD_ONLY]
        return [*added, *(field.name for field in dataclasses.fields(cls.options_type))]

    def __init__(self, vehicle: Vehicle | None = None, **options: Any):
        settings = self.options_type(**options)
        self.vehicle = limited(as_vehicle(vehicle), settings.angle_limit)
        self.pwm_centre = resolve_pwm_centre(settings.pwm_centre, self.vehicle)
        self.pwm_span = resolve_pwm_span(settings.pwm_span, self.vehicle)
        settings.check()
        self.history = int(settings.history)
        self.observe_vehicle = settings.observe_vehicle
        self.options: dict[str, Any] = {}
        self.settings = settings
        self._resolve(pwm_span=self.pwm_span)

    def _resolve(self, **values: Any) -> None:
        """Set options that default to the vehicle, and record what policy files store."""
        self.settings = dataclasses.replace(self.settings, **values)
        self.options = self.settings.recorded()

    # --- what every task must say ----------------------------------------------------------------

    @abc.abstractmethod
    def sample(self, rng: np.random.Generator, k: int) -> Start:
        """Return k random starts."""

    @abc.abstractmethod
    def evaluate(self, context: StepContext) -> Evaluation:
        """Return reward terms, success and end of the step that led to this moment."""

    # --- what an environment asks ----------------------------------------------------------------

    @property
    def plant_options(self) -> dict[str, Any]:
        """Options that every plant of this task needs."""
        return {}

    def prepare(self, plant) -> None:  # noqa: B027 (many have nothing to set up)
        """Set up a plant for this task; raises UserError for an unsuitable one."""

    def start(self, state: np.ndarray) -> Start:
        """Return starts from given states (k, 13)."""
        k = len(state)
        return Start(state, np.zeros(k), np.zeros(k, bool), np.full(k, np.nan))

    @functools.cached_property
    def channels(self) -> tuple[Channel, ...]:
        """The command of each action; commands that no action gives are 0."""
        v = self.vehicle
        found = []
        for name in self.action_names:
            if name == "thrust":
                numbers = (self.pwm_centre, self.pwm_span, *v.command_pwm_range, self.idle_action)
            else:
                limit = v.command_yaw_rate_limit if name == "yaw rate" else v.command_angle_limit
                numbers = (0.0, limit, -limit, limit, None)
            found.append(Channel(name, ACTIONS[name], *numbers))
        return tuple(found)

    @functools.cached_property
    def _channel_rows(self) -> np.ndarray:
        """(a, 6) column, centre, span, low, high and idle of each channel; idle -inf where there is none."""
        rows = [(c.column, c.centre, c.span, c.low, c.high, c.idle) for c in self.channels]
        return np.array([[-math.inf if x is None else x for x in row] for row in rows])

    @property
    def per_vehicle_hover(self) -> bool:
        """Return whether action 0 is the hover of each vehicle (`pwm_centre="own"`), not one PWM for all."""
        return self.settings.pwm_centre == OWN

    def commands(self, actions: np.ndarray, pwm_centre: np.ndarray | None = None) -> np.ndarray:
        """Return plant commands (n, 4) for actions (n, a) in [-1, 1].

        pwm_centre (n,): the PWM at thrust action 0 of each vehicle, where it is not the task's.
        """
        centres = _NO_CENTRES if pwm_centre is None else np.asarray(pwm_centre, float)
        return _commands(np.ascontiguousarray(actions, float), self._channel_rows, centres)

    def body_commands(self, commands: np.ndarray, state: np.ndarray, platform: np.ndarray) -> np.ndarray:
        """Return `commands` (n, 4) along the axes of the vehicles in states (n, 13) over platforms (n, 12).

        By default they already are; some tasks have attitude actions along other axes.
        """
        return commands

    def thrust_of(self, other: Task) -> tuple[float, float]:
        """Return gain and offset that map a thrust action of `other` to the one with the same PWM here."""
        return other.pwm_span / self.pwm_span, (other.pwm_centre - self.pwm_centre) / self.pwm_span

    def observe(self, context: StepContext) -> np.ndarray:
        """Return observations (n, o), float32: those of `observation_names` that the state has."""
        return context.state[:, self._observed].astype(np.float32)

    @functools.cached_property
    def _observed(self) -> np.ndarray:
        return np.array([COLUMNS[name] for name in self.observation_names if name in COLUMNS], int)

    # --- what training and evaluation ask --------------------------------------------------------

    @property
    def observation_centre(self) -> np.ndarray:
        """(o,) that a policy network subtracts from the observation."""
        return np.zeros(len(self.observation_names)) if self.goal is None else self.goal

    @property
    def goal(self) -> np.ndarray | None:
        """The observation (o,) at the goal; None where there is no one goal."""
        return None

    @property
    def goal_half_widths(self) -> np.ndarray | None:
        """(o,) half widths of the goal box around `goal`; None where success is something else."""
        return None

    @property
    def goal_state(self) -> np.ndarray | None:
        """The goal as a state (13,); what is not observed is 0."""
        if self.goal is None:
            return None
        state = np.zeros(STATE_SIZE)
        for name, value in zip(self.observation_names, self.goal):
            if name in COLUMNS:
                state[COLUMNS[name]] = value
        return state

    def goal_on(self, platform: np.ndarray | None) -> np.ndarray | None:
        """Return the goal as a state (13,) for a platform in state (12,), see `Plant.platform`."""
        return self.goal_state

    def in_goal(
        self, state: np.ndarray, goal_size: float | np.ndarray, platform: np.ndarray | None = None
    ) -> np.ndarray:
        """Return (n,) bool: which states (n, 13) are in the goal box of size d = goal_size, (n,) or a number.

        platform (n, 12): the platforms, needed where the slope is observed. A task without a goal box has
        none.
        """
        return np.zeros(len(state), bool)

    def start_clearance(self, start: Start) -> np.ndarray:
        """Return the distance (k,) of the real shapes to the platform [m]; inf without one."""
        return np.full(len(start), np.inf)

    @property
    def judged_steps(self) -> int | None:
        """Largest number of control steps of an evaluated flight; None: max_steps."""
        if self.judged_after is None:
            return None
        return round(self.judged_after / self.vehicle.command_control_period)

    def evaluation_starts(self, rng: np.random.Generator, k: int) -> Start:
        """Return k random starts of the task itself, with the contact parameters of evaluation."""
        return self.sample(rng, k)

    def score(self, flights: Sequence) -> dict[str, float]:
        """Return `score`, at best 1, of recorded flights, and more columns for the learning curves."""
        reward = float(np.mean([flight.reward.sum() for flight in flights]))
        return {"score": float(np.mean([flight.success for flight in flights])), "reward": reward}

    def score_words(self, score: dict[str, float]) -> str:
        """Return a result of `score` in a few words."""
        return f"{100 * score['score']:.0f} %"

    def flight_words(self, flight) -> str:
        """Return how a recorded flight ended, in one line."""
        end = "success" if flight.success else "no success"
        return f"{end} after {flight.duration:.2f} s"

    # --- starts that people name -----------------------------------------------------------------

    @property
    def start_form(self) -> str:
        """The form of a start on the command line: "X,Z" or "X,Y,Z"."""
        return ",".join(self.start_axes).upper()

    def parse_start(self, text: str) -> tuple[float, ...]:
        """Return the start [m] in `text`; raises UserError unless it is in the arena and free."""
        try:
            point = tuple(float(number) for number in text.split(","))
        except ValueError:
            point = ()
        if len(point) != len(self.start_axes) or not all(map(math.isfinite, point)):
            example = ",".join(f"{number:g}" for number in self.film_starts[0])
            raise UserError(f"start must be {self.start_form} in metres, like {example}, not {text!r}")
        for name, value in zip(self.start_axes, point):
            low, high = getattr(self.vehicle, f"arena_{name}")
            if not low < value < high:
                room = f"{name} must be between {low:g} and {high:g} m"
                raise UserError(f"start {text} lies outside the arena: {room}")
        self.check_start(point)
        return point

    def check_start(self, point: tuple[float, ...]) -> None:  # noqa: B027 (or to check)
        """Raise UserError if the start `point` [m] is occupied."""

    def start_words(self, state: np.ndarray) -> str:
        """Return the position of a state (13,) as starts are written."""
        return ", ".join(f"{name} {state[COLUMNS[name]]:g}" for name in self.start_axes) + " m"

    def states_at(self, points: Sequence[tuple[float, ...]]) -> np.ndarray:
        """Return states (k, 13) of vehicles hovering at k starts [m]."""
        positions = np.zeros((len(points), 3))
        positions[:, [COLUMNS[name] for name in self.start_axes]] = points
        return hover_states(positions, self.vehicle)


def resolve_pwm_centre(centre, vehicle: Vehicle) -> float:
    """Return the PWM at action 0 for a number, "paper" (42 000), "hover" or "own".

    "hover" is that of the vehicle that a policy is trained for (`forces.settled_hover`), also on another
    vehicle; "own" is that of each vehicle that it flies.
    """
    if isinstance(centre, str) and centre == "paper":
        return vehicle.command_pwm_centre
    if isinstance(centre, str) and centre in ("hover", OWN):
        return settled_hover(vehicle)
    low, high = vehicle.command_pwm_range
    if isinstance(centre, (int, float)) and low <= centre <= high:
        return float(centre)
    said = shown(repr(centre), 40)
    raise UserError(
        f"pwm_centre must be 'paper', 'hover', 'own' or a PWM from {low:g} to {high:g}, not {said}"
    )


def resolve_pwm_span(span, vehicle: Vehicle) -> float:
    """Return the PWM between action 0 and 1 for a number, or for None the vehicle file's (16 500)."""
    if span is None:
        return vehicle.command_pwm_span
    high = vehicle.command_pwm_range[1]
    if isinstance(span, (int, float)) and 1.0 <= span <= high:
        return float(span)
    raise UserError(f"pwm_span must be a PWM from 1 to {high:g}, not {shown(repr(span), 40)}")


def limited(vehicle: Vehicle, angle_limit: float | None) -> Vehicle:
    """Return the vehicle with roll and pitch commands up to angle_limit [rad]; None: unchanged."""
    if angle_limit is None:
        return vehicle
    low, high = next(c.range[0] for c in constants() if c.field == "command_angle_limit")
    if isinstance(angle_limit, (int, float)) and low <= angle_limit <= high:
        return vehicle.changed(command_angle_limit=float(angle_limit))
    said = shown(repr(angle_limit), 40)
    raise UserError(f"angle_limit must be an angle from {low:g} to {high:g} rad, not {said}")


def hover_states(positions: np.ndarray, vehicle: Vehicle) -> np.ndarray:
    """Return states (k, 13) at rest, level, thrust settled at hover, at positions (k, 3) [m]."""
    state = np.zeros((len(positions), STATE_SIZE))
    state[:, :3] = positions
    state[:, LAG] = vehicle.hover_lag
    return state
