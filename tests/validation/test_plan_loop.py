"""The planned loop: its cases, the plan as the simulator flies it, and its counts."""

from types import SimpleNamespace

import numpy as np

from tests.validation import plan_loop, simulator
from tests.validation.gap_blind.causes import FREE_FLIGHT
from tests.validation.simulator import control


def test_causes_take_turns_and_sizes_with_them():
    some = [plan_loop.drawn(seed) for seed in (1, 2, len(FREE_FLIGHT) + 1)]
    assert [case.causes[0] for case in some] == [*list(FREE_FLIGHT)[:2], next(iter(FREE_FLIGHT))]
    assert [case.size for case in some] == ["weak", "weak", "medium"]


def test_the_simulator_flies_a_plan_where_it_leads():
    t = np.arange(0.0, 6.0, 0.01)
    # A quintic from rest to rest along x, then a hover; the yaw turns by 0.5 rad meanwhile.
    u = np.clip((t - 1.0) / 3.0, 0.0, 1.0)
    way = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    position = np.column_stack([0.8 * way, np.zeros_like(t), np.ones_like(t)])
    velocity = np.gradient(position, 0.01, axis=0)
    points = SimpleNamespace(velocity=velocity, acceleration=np.gradient(velocity, 0.01, axis=0))
    rows = plan_loop.path_of(
        SimpleNamespace(path=SimpleNamespace(position=position, yaw=0.5 * way), points=points)
    )
    assert rows.shape == (len(t) // 2, control.REF_SIZE)
    flown = simulator.fly(rows, simulator.World(), np.random.default_rng(0), simulator.reference())
    # Half a metre per second and its pilot's lag: within centimetres along the way, closer at its end.
    at = np.interp(flown.t, t, position[:, 0])
    assert np.abs(flown.truth[:, 0] - at).max() < 0.1 and abs(flown.truth[-1, 0] - 0.8) < 0.03
    assert abs(flown.truth[-1, 8] - 0.5) < 0.05


def test_no_planned_flight_leaves_the_first_answer():
    def row(first, **more):
        answers = {"first": first} | more
        said = {k: {"answer": a, "truth": 0.5, "verdict": "effects", "sure": []} for k, a in answers.items()}
        return {"cause": "wind", "size": "weak"} | said

    rows = [
        row("right"),
        row("in doubt", ordinary="right"),
        row("in doubt", ordinary="in doubt", planned="right"),
    ]
    lines = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in plan_loop.markdown(rows).splitlines()
    ]
    assert lines[2:6] == [
        ["one flight, all cases", "3", "1", "0", "2"],
        ["one flight, in doubt before", "2", "0", "0", "2"],
        ["and a planned one, in doubt before", "2", "1", "0", "1"],
        ["and an ordinary one, in doubt before", "2", "1", "0", "1"],
    ]
    assert lines[9] == ["wind, weak", "in doubt, 0.50", "none planned", "right, 0.50"]
