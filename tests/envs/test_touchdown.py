"""`InclinedTouchdown`: when a moment is held, what it pays, idle motors, and the plant that is needed."""

import math

import numpy as np
import pytest

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.tasks import InclinedTouchdown, StepContext, hover_states, make_task
from inclined_landing.envs.tasks.landing import LOWEST_START, START_CLEARANCE
from inclined_landing.envs.tasks.touchdown import GENTLE_FORCE, HOLD_STEPS, TouchdownConditions
from inclined_landing.models.attitude import PITCH, STATE_SIZE, VX, WY, X, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import Contacts, MujocoPlant, make_plant

V = load_vehicle()
TASK = InclinedTouchdown(pwm_centre="hover")
WEIGHT = V.body_mass * V.environment_gravity
IDLE, FLY = np.array([-1.0, -0.77]), np.array([0.0, -0.77])  # 0.77 holds the slope's attitude


def resting() -> np.ndarray:
    """The state (1, 13) of a vehicle that stands on the slope, thrust gone."""
    state = np.zeros((1, STATE_SIZE))
    state[0, [X, Z]] = TASK.rest_position
    state[0, PITCH] = TASK.inclination
    return state


def judge(state=None, action=IDLE, touching=((0, 0),), force=WEIGHT, held_steps=0, conditions=None):
    """Evaluation of one moment; touching: (surface, part) pairs."""
    state = resting() if state is None else state
    task = InclinedTouchdown(pwm_centre="hover")
    task.conditions = conditions or TouchdownConditions()
    contacts = Contacts(np.zeros((1, 3, 3), bool), np.zeros((1, 3, 3), bool), np.zeros((1, 3, 3)))
    for pair in touching:
        contacts.touch[0][pair] = contacts.near[0][pair] = True
        contacts.force[0][pair] = force
    count, start = np.ones(1, int), task.start(state)
    records = start, count, 9 * count, np.array([held_steps])
    return task.evaluate(
        StepContext(state, contacts, action[None], *records, platform=start.platforms(task.vehicle))
    )


def terms(evaluation) -> dict:
    return {name: float(term[0]) for name, term in evaluation.terms.items() if term[0]}


def test_at_rest_on_the_feet_with_idle_motors_is_held_and_free():
    verdict = judge()
    assert verdict.holding[0] and not terms(verdict) and not verdict.success[0]


@pytest.mark.parametrize(
    ("case", "paid"),
    [
        ({"action": FLY}, {"time": -1.0}),
        ({"touching": ()}, {"time": -1.0}),
        ({"touching": ((0, 0), (0, 2))}, {"time": -1.0, "obstacle": -6.0}),
        ({"touching": ((0, 0), (1, 0))}, {"time": -1.0, "obstacle": -6.0}),
        ({"force": (GENTLE_FORCE + 3) * WEIGHT}, {"impact": -3 * 0.5}),
    ],
)
def test_each_moment_that_is_not_held_costs(case, paid):
    assert terms(judge(**case)) == pytest.approx(paid)
    assert judge(**case).reward[0] == pytest.approx(sum(paid.values()))


@pytest.mark.parametrize(("column", "value"), [(VX, 0.06), (WY, 1.1)])
def test_a_moving_vehicle_is_not_at_rest(column, value):
    state = resting()
    state[0, column] = value
    assert terms(judge(state)) == {"time": -1.0}


def test_success_is_held_for_three_tenths_of_a_second():
    assert HOLD_STEPS * V.command_control_period == pytest.approx(0.3)
    before, now = judge(held_steps=HOLD_STEPS - 2), judge(held_steps=HOLD_STEPS - 1)
    assert not before.terminated[0] and now.terminated[0] and now.success[0]
    assert not judge(held_steps=HOLD_STEPS - 1, action=FLY).success[0]


def test_near_the_bounds_and_training_aids():
    state = resting()
    state[0, X] = 3.38
    assert terms(judge(state, FLY, ())) == {"time": -1.0, "bounds": -1.0}
    aids = TouchdownConditions(contact_limit=8, leave_limit=0.3)
    assert judge(touching=((0, 1),), conditions=aids).truncated[0]
    priced = judge(
        touching=((0, 1),), conditions=TouchdownConditions(contact_limit=8, out_of_bounds_penalty=150.0)
    )
    assert priced.terminated[0] and not priced.truncated[0] and not priced.success[0]
    assert terms(priced) == {"time": -1.0, "obstacle": -6.0, "out_of_bounds": -150.0}
    assert not judge(conditions=aids).truncated[0]  # feet may stay as long as they like


def test_only_the_mujoco_plant_can_judge():
    with pytest.raises(UserError, match="needs the MuJoCo plant"):
        BatchEnv(TASK, make_plant("analytic", 1))


def test_a_vehicle_that_stands_there_succeeds_after_fifteen_held_steps():
    env = BatchEnv(make_task("touchdown"), MujocoPlant(2, threads=1))
    env.reset(state=np.repeat(resting(), 2, axis=0))
    rewards = 0.0
    for _ in range(40):
        step = env.step(np.array([IDLE, FLY]))
        rewards += step.reward[0]
        if step.terminated[0]:
            break
    # The feet settle into the contact spring for at most 0.1 s before.
    assert step.success.tolist() == [True, False] and HOLD_STEPS <= env.length[0] <= HOLD_STEPS + 5
    assert env.held_steps[0] == HOLD_STEPS and rewards >= -5.0
    env.reset(np.array([0]))
    assert env.held_steps.tolist() == [0, 0]


def test_idle_motors_make_no_torque_and_only_when_asked_for():
    state = resting()
    state[0, [X, Z, PITCH]] = 0.0, 2.0, 0.3

    def fall(needed, commands):
        plant = MujocoPlant(1, threads=1)
        plant.torque_needs_motors = needed
        plant.set_platform([0], 0.0, False)
        plant.reset([0], state)
        for u in commands:
            plant.step(np.array([u]))
        return plant.state.copy()

    off, on = [0.0, 0, -0.5, 0], [30000.0, 0, -0.5, 0]
    free = fall(True, [off] * 10)
    assert np.abs(free[0, WY]) < 1e-9 and free[0, PITCH] == pytest.approx(0.3)
    assert fall(False, [off] * 10)[0, PITCH] < 0.2  # the paper's loop needs no motors
    np.testing.assert_array_equal(fall(True, [on] * 10), fall(False, [on] * 10))
    back = fall(True, [off] * 3 + [on] * 7)  # the torque returns with the motors
    assert back[0, WY] < -0.5


def test_contact_can_be_observed():
    task = make_task("touchdown", observe_contact=True)
    assert task.options["observe_contact"] and task.observation_names[-1] == "feet"
    assert len(task.observation_centre) == len(task.observation_scale) == 6
    env = BatchEnv(task, MujocoPlant(1, threads=1))
    assert env.reset(state=resting()).shape == (1, 6)
    assert env.step(IDLE[None]).observation[0, 5] == 1.0
    assert make_task("touchdown").observe(StepContext(resting())).shape == (1, 5)
    with pytest.raises(UserError, match="observes the contact of the feet"):
        task.observe(StepContext(resting()))


def test_training_starts_draw_contact_and_closeness():
    task = InclinedTouchdown()
    assert task.sample(np.random.default_rng(0), 4).contact is None
    task.conditions = TouchdownConditions(close=1.0, friction=(0.55, 1.2), restitution=(0.0, 0.5))
    start = task.sample(np.random.default_rng(0), 500)
    assert task.start_clearance(start).min() > -1e-9
    x, z = start.state[:, X], start.state[:, Z] - V.platform_surface_height
    height = x * math.sin(task.inclination) + z * math.cos(task.inclination)
    assert height.max() < 0.28 and np.abs(start.state[:, PITCH] - task.inclination).max() < 0.15
    friction, restitution = start.contact["friction"], start.contact["restitution"]
    assert 0.55 <= friction.min() < 0.6 < 1.15 < friction.max() <= 1.2 and np.median(friction) < 0.65
    assert 0.0 <= restitution.min() < 0.05 and restitution.max() <= 0.5 and np.median(restitution) > 0.3
    plant = MujocoPlant(500, threads=1)
    BatchEnv(task, plant, seed=0).reset()
    assert len(np.unique(plant.save()["contact"][:, 0])) == 500


def test_starts_drawn_again_replace_their_contact_too():
    """As `BatchEnv` does for the larger vehicles of a pool."""
    task, rng = make_task("touchdown"), np.random.default_rng(0)
    task.conditions = TouchdownConditions(friction=(0.55, 1.2), restitution=(0.0, 0.5))
    start, again, rows = task.sample(rng, 4), task.sample(rng, 2), np.array([1, 3])
    kept = start[[0, 2]]
    start.put(rows, again)
    for one, other in ((start[rows], again), (start[[0, 2]], kept)):
        np.testing.assert_array_equal(one.state, other.state)
        assert {name: x.tolist() for name, x in one.contact.items()} == {
            name: x.tolist() for name, x in other.contact.items()
        }
    assert set(start.contact) == {"friction", "restitution", "contact_time"}


def test_training_starts_around_the_raised_edge():
    task = InclinedTouchdown()
    task.conditions = TouchdownConditions(around_edge=1.0)
    start = task.sample(np.random.default_rng(0), 500)
    assert task.start_clearance(start).min() >= START_CLEARANCE
    x, z = start.state[:, X], start.state[:, Z]  # the default slope rises towards +x
    assert x.min() < 0.0 and 1.0 < x.max() <= 2.5 * V.slab_half_length
    assert LOWEST_START <= z.min() and z.max() > 2.2 and np.mean(z < 1.5) > 0.3
    at_rest = hover_states(np.column_stack([x, z]), task.vehicle)
    np.testing.assert_array_equal(start.state[:, VX:], at_rest[:, VX:])
