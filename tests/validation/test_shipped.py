"""What commands of `python -m tests.validation` were run for: the shipped flights and vehicles."""

import pandas
import pytest

from inclined_landing.eval import cli
from inclined_landing.models.parameters import load_vehicle, locate_vehicle
from tests.validation import gap_example
from tests.validation.identified import vehicles


@pytest.mark.slow
def test_the_shipped_flights_are_what_the_generator_makes(tmp_path, capsys):
    assert cli.main(["gap-example", "--out", str(tmp_path / "copied")]) == 0
    gap_example.command(tmp_path / "made")
    lines = capsys.readouterr().out.splitlines()
    assert [line.replace("copied", "made") for line in lines[:2]] == lines[2:]
    folders = [tmp_path / "copied", tmp_path / "made"]
    names = [sorted(p.relative_to(folder) for p in folder.rglob("*.csv")) for folder in folders]
    assert names[0] == names[1] and len(names[0]) == 20
    for name in names[0]:
        flights = [pandas.read_csv(folder / name) for folder in folders]
        # The last of six decimals, where another processor rounds another way; of a PWM of 40 000 more.
        pandas.testing.assert_frame_equal(*flights, rtol=1e-9, atol=2e-6)


@pytest.mark.parametrize("name", vehicles())
def test_a_shipped_vehicle_is_what_its_entry_says(name):
    entry, vehicle = vehicles()[name], load_vehicle(name)
    assert vehicle.body_mass == entry["mass"] and vehicle != load_vehicle(entry["base"])
    text = locate_vehicle(name).read_text("utf-8")
    assert f'based_on = "{entry["base"]}"' in text
    assert entry["commit"] in text
