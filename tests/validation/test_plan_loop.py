"""The planned loop: the plan as the simulator flies it, and its counts."""

import numpy as np

from inclined_landing.eval.gap.plan import pieces
from inclined_landing.eval.gap.plan.pieces import setpoints
from inclined_landing.models.parameters import load_vehicle
from tests.validation import plan_loop, simulator
from tests.validation.simulator import control


def test_the_simulator_flies_a_plan_where_it_leads():
    vehicle, reality = load_vehicle(), simulator.reference()
    manoeuvres = [pieces.midpoint(kind) for kind in ("circle", "heave", "thrusts", "low_hover")]
    path = pieces.joined_path(manoeuvres, pieces.Space.of(vehicle, platform=False))
    rows = plan_loop.path_of(setpoints(path, vehicle), reality.constants)
    assert rows.shape == (-(-len(path.yaw) // 2), control.REF_SIZE)
    flown = simulator.fly(rows, simulator.World(), np.random.default_rng(0), reality)
    planned = np.column_stack([np.interp(flown.t, path.t, x) for x in path.position.T])
    off = np.linalg.norm(flown.truth[:, :3] - planned, axis=1)
    # A circle at 1.1 m/s; a pilot without the plan's commands lags it by a loop of 0.18 s, which is 0.2 m.
    assert off.max() < 0.12
    turned = flown.truth[:, 8] - np.interp(flown.t, path.t, path.yaw)
    assert np.abs(np.angle(np.exp(1j * turned))).max() < 0.1


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
