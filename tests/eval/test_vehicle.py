"""One vehicle everywhere: every command that flies one takes a vehicle file, and it reaches what is flown."""

import dataclasses
import inspect
import json

import numpy as np
import pytest

from inclined_landing.eval import cli
from inclined_landing.eval.landings.parameters import known_parameters
from inclined_landing.eval.landings.study import read_study
from inclined_landing.eval.truth.contact import laws
from inclined_landing.models.parameters import load_vehicle, write_vehicle

V = load_vehicle()
HEAVY = dataclasses.replace(V, body_mass=1.1 * V.body_mass)
NO_VEHICLE = {"benchmark", "demo", "export", "curves", "logs", "plan", "gap-example", "doctor"}


@pytest.mark.parametrize("name", [name for name in cli.COMMANDS if name not in NO_VEHICLE])
def test_commands_that_fly_take_a_vehicle(name):
    options = {}
    for parameter in inspect.signature(cli.find(name), eval_str=True).parameters.values():
        options[parameter.name] = parameter
        group = getattr(parameter.annotation, "__origin__", None)
        if dataclasses.is_dataclass(group):
            options |= {field.name: field for field in dataclasses.fields(group)}
    assert "vehicle" in options or "vehicles" in options


def test_a_success_table_is_of_the_vehicle(tmp_path, capsys):
    """Action 0 keeps the thrust of training, so that a heavier vehicle sinks and another one flies."""
    write_vehicle(tmp_path / "heavy.toml", HEAVY)
    reports = []
    for option in ([], ["--vehicle", str(tmp_path / "heavy.toml")]):
        assert cli.main(["success", "setpoint", "--plant", "analytic", "--json", *option]) == 0
        reports.append(json.loads(capsys.readouterr().out))
    shipped, heavy = (
        next(row["value"] for row in report["rows"] if row["measure"] == "mean_error") for report in reports
    )
    assert heavy > shipped + 0.005


def test_a_study_is_of_the_vehicle_and_says_so():
    shipped, heavy = read_study("paper_landing"), read_study("paper_landing", HEAVY)
    assert shipped.fingerprint() != heavy.fingerprint()
    assert known_parameters(heavy.vehicle)["mass"].default == HEAVY.body_mass


def test_contact_is_that_of_the_vehicle():
    """At rest on a slope the normal force is the vehicle's own weight's."""
    found = laws.rest(HEAVY).data
    expected = 1.1 * V.weight * np.cos(np.radians(found["degrees"]))
    np.testing.assert_allclose(found["normal"], expected, rtol=1e-3)
