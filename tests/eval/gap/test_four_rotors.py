"""Flights as people have them: with requests of four motors, without attitude commands, by rotor speeds."""

import dataclasses
import json

import numpy as np
import pytest

from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.answer.identification import identify
from inclined_landing.eval.gap.infer.gaussian import Spread
from inclined_landing.eval.gap.measured.windows import REQUEST_SIGNS, prepare, prepare_all
from inclined_landing.eval.gap.model.columns import slab_covariance
from inclined_landing.eval.gap.model.prediction import predict, requested_differences
from inclined_landing.eval.gap.model.problem import Problem, identifiable_effects
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import AnalyticPlant

V = load_vehicle()
DT = 0.02


def flown(vehicle, seed: int, seconds: float = 16.0) -> FlightLog:
    """A flight of random commands about hover in the equations, with the requests of its motors.

    Its controller has an integrator: thrust beside the centre of mass tilts it no more.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / DT)
    balanced = vehicle.changed(effects_com_offset=vehicle.thrust_centre)
    plant = AnalyticPlant(1, balanced, attitude="rate_loop", control_period=DT, substeps=5)
    start = np.zeros((1, 13))
    start[0, 2], start[0, 12] = 30.0, vehicle.hover_lag
    plant.reset(np.arange(1), start)
    slow = np.repeat(rng.standard_normal((n // 20 + 1, 3)), 20, axis=0)[:n]
    commands = np.c_[vehicle.hover_pwm * (1.0 + 0.08 * slow[:, 0]), 0.15 * slow[:, 1:], np.zeros(n)]
    states = np.empty((n, 13))
    for k in range(n):
        states[k] = plant.state[0]
        plant.step(commands[k][None])
    noise = 1e-3 * rng.standard_normal((n, 6))
    log = FlightLog(
        f"flight {seed}",
        DT * np.arange(n),
        states[:, :3] + noise[:, :3],
        states[:, 6:9] + noise[:, 3:],
        commands,
    )
    # r_i ~ (1 + relative torques)/(1 - loss): here by the definition, motor by motor.
    loss, offset = np.array(vehicle.effects_rotor_loss), np.array(vehicle.effects_com_offset)
    turning = np.gradient(states[:, 9:12], DT, axis=0) * vehicle.body_inertia / (vehicle.body_mass * 9.81)
    torques = (turning * [1.0, 1.0, 0.0] + [offset[1], -offset[0], 0.0]) / vehicle.rotor_arm
    shares = (1.0 + torques @ REQUEST_SIGNS) / (1.0 - loss)
    uneven = 1.0 + 0.02 * rng.standard_normal((n, 4))
    requests = commands[:, :1] * shares / shares.mean(axis=1, keepdims=True) * uneven
    return dataclasses.replace(log, requests=requests)


def test_signs_of_the_requests():
    """Front right M1, back right M2, back left M3, front left M4; a torque about x lifts the left side."""
    places = np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]])  # x forward, y left
    np.testing.assert_array_equal(REQUEST_SIGNS[0], places[:, 1])
    np.testing.assert_array_equal(REQUEST_SIGNS[1], -places[:, 0])
    np.testing.assert_array_equal(REQUEST_SIGNS[2], [-1, 1, -1, 1])  # M2 and M4 turn clockwise
    assert not (REQUEST_SIGNS @ REQUEST_SIGNS.T - 4 * np.eye(3)).any()


@pytest.mark.parametrize(
    "change",
    [
        {"effects_rotor_loss": (0.0, 0.0, 0.2, 0.0)},
        {"effects_com_offset": (0.002, -0.001)},
        {"effects_yaw_imbalance": 0.05},
    ],
)
def test_requests_balance_force_and_torque(change):
    """With the requested forces, the rotors give the torques of the centre of mass, and no others."""
    vehicle = V.changed(**change)
    flight = prepare(flown(V, 3), vehicle)
    still = dataclasses.replace(
        flight, requests=dataclasses.replace(flight.requests, torques=np.zeros((flight.samples, 3)))
    )
    wanted = requested_differences(still, vehicle)[0]
    # Requests with these differences, of mean 1; forces f_i = r_i (1 - loss_i); torque sum s_i f_i / sum f_i.
    forces = (1.0 + wanted @ REQUEST_SIGNS) * (1.0 - np.array(vehicle.effects_rotor_loss))
    torque = REQUEST_SIGNS @ forces / forces.sum()
    x, y = vehicle.effects_com_offset
    expected = [y / V.rotor_arm, -x / V.rotor_arm, vehicle.effects_yaw_imbalance]
    np.testing.assert_allclose(torque, expected, atol=1e-12)


@pytest.mark.slow
def test_a_weak_rotor_is_named_and_not_a_weight():
    reference = identify([flown(V, k) for k in range(4)], V)
    weak = V.changed(effects_rotor_loss=(0.0, 0.0, 0.15, 0.0))
    d = diagnose([flown(weak, k) for k in range(10, 13)], reference.vehicle, reference=reference.reference)
    named = {e.name: e for e in d.effects}
    assert "weak_rotor_3" in named and named["weak_rotor_3"].sure
    low, high = named["weak_rotor_3"].parameters["loss"].ci95
    assert low < 0.15 < high
    assert not {"mass", "thrust_scale", "com_offset", "weak_rotor_1", "weak_rotor_2", "weak_rotor_4"} & set(
        named
    )


def test_without_requests_these_effects_are_no_candidates():
    flights = prepare_all([dataclasses.replace(flown(V, 1), requests=None)], V, False)[0]
    library, _ = identifiable_effects(LIBRARY, flights)
    assert not any(name.startswith("weak_rotor") or name == "yaw_imbalance" for name in library)
    assert flights[0].channels == 6 and flights[0].measured.shape[1] == 6


def test_requests_in_some_flights_only_are_left_out():
    logs = [flown(V, 1), dataclasses.replace(flown(V, 2), requests=None)]
    assert [f.channels for f in prepare_all(logs, V, False)[0]] == [6, 6]
    assert [f.channels for f in prepare_all(logs[:1], V, False)[0]] == [9]


def test_flights_without_attitude_commands_show_translation_alone():
    log = flown(V, 5, seconds=8.0)
    silent = dataclasses.replace(log, command=np.c_[log.command[:, 0], np.full((len(log), 3), np.nan)])
    flight = prepare(dataclasses.replace(silent, requests=None), V)
    assert flight.logged.tolist() == [True] * 3 + [False] * 3
    problem = Problem.of([flight], V, LIBRARY)
    assert "attitude_gain" not in problem.library and "thrust_scale" in problem.library
    with_commands = prepare(dataclasses.replace(log, requests=None), V)
    np.testing.assert_array_equal(predict(flight, V)[:, :3], predict(with_commands, V)[:, :3])
    heavy = V.changed(body_mass=1.15 * V.body_mass)
    d = diagnose([silent], heavy)
    assert any(LIBRARY[e.name].scales_thrust for e in d.effects)
    # One second open loop along the measured attitude: right once the mass is.
    assert d.gap["analytic"].after < 0.2 * d.gap["analytic"].before
    assert any("attitude commands are not logged" in note for note in d.notes)


def test_without_one_tilt_angle_only_the_vertical_motion_counts():
    log = flown(V, 6)
    attitude = log.attitude.copy()
    attitude[:, 1] = np.nan
    flight = prepare(dataclasses.replace(log, attitude=attitude, requests=None), V)
    assert flight.logged[:3].tolist() == [False, False, True]


def test_measured_rotor_speeds_lag_behind_nothing():
    log = dataclasses.replace(flown(V, 7), requests=None, thrust_is_measured=True)
    flight = prepare(log, V)
    library, _ = identifiable_effects(LIBRARY, [flight])
    assert not any(effect.of_the_drive for effect in library.values()) and "thrust_scale" in library
    slow = V.changed(thrust_lag_rate=0.5 * V.thrust_lag_rate, thrust_state_gain=0.5 * V.thrust_state_gain)
    np.testing.assert_allclose(predict(flight, slow)[:, 2], predict(flight, V)[:, 2], atol=1e-9)
    with pytest.raises(UserError, match="thrust from measured rotor speeds, others from commands"):
        prepare_all([log, flown(V, 8)], V, False)[0]


def test_how_a_battery_was_put_in_is_shared_by_the_flights_of_a_day():
    """Many flights do not average it out: it is no change of the vehicle, where requests show it."""
    spikes = Spread().spike_deviations

    def offset(problem):
        return next(c for c in problem.columns(["com_offset"]) if c.parameter == "x")

    few, many = (
        Problem.of(flights, V, identifiable_effects(LIBRARY, flights)[0])
        for flights in (prepare_all([flown(V, k) for k in range(n)], V, False)[0] for n in (2, 6))
    )
    for problem in (few, many):
        x = offset(problem)
        slab = np.sqrt(slab_covariance(problem, [x])[0, 0])
        assert spikes(problem, [x])[0] >= min(problem.variation(x).placement, 0.5 * slab) - 1e-12
    silent = prepare_all([dataclasses.replace(flown(V, k), requests=None) for k in range(6)], V, False)[0]
    unseen = Problem.of(silent, V, identifiable_effects(LIBRARY, silent)[0])
    assert spikes(unseen, [offset(unseen)])[0] < 0.5 * spikes(many, [offset(many)])[0]


def with_measured_speeds(seed: int, sensor: float = 1.0) -> FlightLog:
    """A flight whose thrust is that of four rotor speeds; the sensor of M3 shows a share of its speed."""
    log = flown(V, seed, seconds=4.0)
    squares = np.repeat(log.command[:, :1], 4, axis=1) * [1.05, 0.95, 1.0, 1.0]  # PWM goes with the square
    squares[:, 2] *= sensor**2
    command = np.c_[squares.mean(axis=1), np.full((len(log), 3), np.nan)]
    speeds = 2000.0 * np.sqrt(squares / 65535.0)
    return dataclasses.replace(
        log, command=command, requests=None, rotor_speed=speeds, thrust_is_measured=True
    )


@pytest.mark.parametrize("answer", [diagnose, identify])
def test_a_flight_whose_speed_sensor_fails_is_named_and_left_out(answer):
    good, bad = [with_measured_speeds(seed) for seed in (1, 2)], with_measured_speeds(4, sensor=0.5)
    found, alone = answer([good[0], bad, *good[1:]], V), answer(good, V)
    (one,) = found.set_aside
    assert one.flight == "flight 4" and one.reason.startswith("rotor speed of M3 is 0.5")
    assert found.flights == tuple(log.name for log in good)
    record = [json.loads(storage.to_json(one.to_json())) for one in (found, alone)]
    (entry,) = record[0].pop("set_aside")
    assert entry == {"flight": one.flight, "reason": one.reason} and not record[1].pop("set_aside")
    # Beside that, the answer is that of the others.
    for r in record:
        r.pop("seconds", None)
    assert record[0] == record[1]


def test_flights_whose_speed_sensors_all_fail_are_refused_by_name():
    with pytest.raises(UserError, match=r"flight 4: rotor speed of M3 is 0\.5"):
        diagnose([with_measured_speeds(4, sensor=0.5)], V)


def test_slabs_stay_wider_than_spikes_however_much_flights_differ():
    """What a set adds to the prior of its effects is a covariance: positive definite."""
    flights = prepare_all([flown(V, 1)], V, False)[0]
    problem = Problem.of(flights, V, identifiable_effects(LIBRARY, flights)[0])
    columns = problem.columns(problem.library)
    spread = dataclasses.replace(Spread(), between={c.key: 1e3 for c in columns})
    spike = spread.spike_deviations(problem, columns)
    added = slab_covariance(problem, columns) / np.outer(spike, spike) - np.eye(len(columns))
    assert np.linalg.eigvalsh(added).min() > 0.1
