"""The whole chain of a flight, every fault in it, and how what happened is judged."""

import dataclasses
import math

import numpy as np
import pytest

from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.eval.flying.fly import FlightOptions
from inclined_landing.eval.flying.simulated import firmware
from inclined_landing.eval.flying.simulated.firmware import State
from inclined_landing.eval.flying.simulated.world import Setting, Trace
from inclined_landing.models.attitude import PITCH, PITCH_COMMAND, PWM, VX, X, Z
from inclined_landing.models.plants import make_plant
from tests.validation import flight_table as faults
from tests.validation.flight_table import Flown, fly_once, truth_of


@pytest.fixture(scope="module")
def plan():
    return FlightOptions("landing").plans()[2]


def trace(states, touching, running):
    """A trace at 100 Hz from states {column: (m,)}, touched surfaces (m, 3), and motors on or off (m,)."""
    m = len(running)
    state = np.zeros((m, 13))
    for column, values in states.items():
        state[:, column] = values
    command = np.zeros((m, 4))
    command[:, 0] = 40000.0 * np.asarray(running)
    time = 0.01 * np.arange(m)
    return Trace(time, state, np.asarray(touching, bool), command, np.full(m, State.FLYING))


def touched(m, surface=None, since=0):
    result = np.zeros((m, 3), bool)
    if surface is not None:
        result[since:, surface] = True
    return result


# --- how it is judged --------------------------------------------------------------------------------


def test_a_landing_is_seen_as_it_was(plan):
    task, m = plan.final.policy.task, 200
    x, z = task.goal_position
    way = np.linspace(1.0, 0.0, 100)
    states = {
        X: np.r_[x + way, np.full(100, x)],
        Z: np.r_[z + way, np.full(100, z)],
        PITCH: np.full(m, task.inclination),
    }
    there = int(np.argmax(way < task.goal_size))
    truth = truth_of(trace(states, touched(m, 0, 120), np.arange(m) < 110), plan)
    assert truth.goal == pytest.approx(0.01 * there) and truth.touched == pytest.approx(1.2)
    assert truth.off == pytest.approx(1.09) and truth.outside == 0.0
    assert truth.strict and truth.landed and truth.rests == "platform"
    early = truth_of(trace(states, touched(m, 0, there - 1), np.arange(m) < 110), plan)
    assert not early.strict and early.landed
    upside_down = truth_of(trace({**states, PITCH: np.full(m, math.pi)}, touched(m, 0, 50), np.ones(m)), plan)
    assert upside_down.rests == "platform" and not upside_down.landed


def test_moving_flying_and_being_outside_are_seen(plan):
    m, v = 100, plan.final.policy.task.vehicle
    moving = truth_of(trace({VX: np.full(m, 0.1), Z: 0.02}, touched(m, 2), np.zeros(m)), plan)
    assert moving.rests == ""
    hovering = truth_of(trace({Z: 1.0}, touched(m), np.ones(m)), plan)
    assert hovering.rests == ""
    far = truth_of(
        trace({X: np.linspace(0, v.arena_x[1] + 0.7, m), Z: 0.02}, touched(m, 2), np.zeros(m)), plan
    )
    assert far.outside == pytest.approx(0.7) and far.rests == "floor"


def test_a_fault_is_safe_in_time_at_rest_and_inside(plan):
    m = 500
    truth = truth_of(trace({Z: 0.02}, touched(m, 2), np.arange(m) < 300), plan)
    flown = Flown(1, {"outcome": "link lost"}, truth, 2.0)
    case = faults.Case("link-lost", "", 1.0, 0.0, "")
    assert truth.off == pytest.approx(2.99) and faults.is_safe(case, flown)
    row = faults.fault_row(case, [flown, dataclasses.replace(flown, began=None)])
    assert (row["safe"]["count"], row["safe"]["of"]) == (1, 1)  # of those in which it came to happen
    assert row["motors off, worst [s]"] == pytest.approx(0.99)
    assert not faults.is_safe(dataclasses.replace(case, limit=0.9), flown)
    for worse in ({"rests": ""}, {"outside": 0.1}):
        other = dataclasses.replace(flown, truth=dataclasses.replace(truth, **worse))
        assert not faults.is_safe(case, other)


def test_the_limit_of_a_vehicle_left_alone_is_what_commands_can_do(plan):
    """From hover at each of the starts: 0.5 s of full thrust and lean, then full thrust, then none."""
    v = plan.final.policy.task.vehicle
    starts = [plan.start_point for plan in FlightOptions("landing").plans()]
    plant, farthest = make_plant("mujoco", 2 * len(starts), v, threads=1), 0.0
    plant.set_platform(np.arange(plant.n), 0.0, False)
    plant.reset(np.arange(plant.n), hover_states(np.array(starts * 2), v))
    lean = np.repeat([v.command_angle_limit, -v.command_angle_limit], len(starts))
    for k in range(300):
        time, command = k * v.command_control_period, np.zeros((plant.n, 4))
        command[:, PITCH_COMMAND] = lean * (time < firmware.WATCHDOG_LEVELS + firmware.PERIOD)
        command[:, PWM] = v.command_pwm_range[1] * (time < firmware.EMERGENCY_WATCHDOG + firmware.PERIOD)
        plant.step(command)
        farthest = max(farthest, np.abs(plant.state[:, X]).max() - v.arena_x[1])
    assert plant.contacts.touch[:, 2].any(axis=1).all(), "all are down"
    assert 0.95 * faults.ALONE < farthest < faults.ALONE


# --- flights -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_landing_through_the_whole_chain_is_what_the_pilot_reports(plan):
    flown = fly_once(plan, Setting(), 11)
    assert flown.report["outcome"] == "goal box" and flown.truth.goal is not None
    assert flown.truth.landed and flown.report["rests"] and flown.truth.outside == 0.0
    assert flown.report["final"] == pytest.approx(flown.truth.last, abs=0.005)  # noise of 0.5 mm, at rest
    assert flown.began is None
    assert faults.start_row("landing", "nominal", [flown])["truly, before a touch"]["count"] == 1


@pytest.mark.slow
@pytest.mark.parametrize("case", faults.CASES, ids=[case.name for case in faults.CASES])
@pytest.mark.parametrize("seed", range(101, 105))
def test_every_fault_ends_in_motors_off_in_time(plan, case, seed):
    flown = fly_once(plan, Setting(), seed, case)
    assert flown.began is None or faults.is_safe(case, flown), flown
