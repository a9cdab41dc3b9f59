"""Files in the layouts of the public sets, with made-up rows, become documented CSV."""

import math

import numpy as np
import pandas as pd
import pytest

from inclined_landing.eval.logs import read_log
from tests import ROOT
from tests.log_files import sd_card
from tests.validation.__main__ import main
from tests.validation.convert import convert, public_sets

DATA = ROOT.parent / "shared" / "data"


def original(name: str, rows: int = 3, **columns) -> pd.DataFrame:
    """A table with the columns that the set's files have, zero where nothing is given."""
    names = [of["from"] for of in public_sets()[name].columns.values()]
    return pd.DataFrame({n: columns.get(n, np.zeros(rows)) for n in names})


def test_nanobench_is_turned_into_si_units_and_the_documented_frame(tmp_path):
    table = original(
        "nanobench",
        t=[1700000000.25, 1700000000.26, 1700000000.27],
        px=[0.1234567, 0.2, 0.3],
        qw=[2.0, 2.0, 2.0],
        imu_acc_z=[1.0, 1.0, 0.5],
        pid_controller_pitch=[-10.0, 0.0, 10.0],
        pid_controller_cmd_thrust=[40000.4, 41000.0, 42000.0],
        att_stateEstimate_pitch=[-90.0, 0.0, 90.0],
        motor_motor_m2=[30000.0, 70000.0, -1.0],
    )
    table.to_csv(tmp_path / "B1_hover_rep1.csv", index=False)
    name, tidy, notes = convert("nanobench", tmp_path / "B1_hover_rep1.csv")
    assert name == "nb_B1_hover_rep1"
    np.testing.assert_allclose(tidy["t"], [0.0, 0.01, 0.02])
    assert tidy["x"][0] == 0.12346
    assert (tidy["qw"] == 1.0).all()
    np.testing.assert_allclose(tidy["imu_az"], [9.807, 9.807, 4.903])
    np.testing.assert_allclose(tidy["cmd_pitch"], [0.17453, 0.0, -0.17453])
    np.testing.assert_allclose(tidy["ekf_pitch"], [1.5708, 0.0, -1.5708])
    assert list(tidy["cmd_thrust_pwm"]) == [40000, 41000, 42000]
    assert list(tidy["m2_pwm"].isna()) == [False, True, True]
    assert tidy["cmd_roll"].isna().all() and not tidy["cmd_pitch"].isna().any()
    assert len(notes) == 2 and "m2_pwm" in notes[0] and notes[1].startswith("always zero: cmd_roll")


def test_utias_keeps_the_phase_and_the_written_digits(tmp_path):
    table = original("utias_fmpc", TIME=[5.0, 5.0163, 5.04], STATUS=["TAKEOFF", "HOVER", "LAND"])
    table["CMD_THRUST"] = [40000.26, 0.0, 1.0]
    (tmp_path / "run").mkdir()
    table.to_csv(tmp_path / "run" / "data_20200101_101010.csv", index=False)
    name, tidy, notes = convert("utias_fmpc", tmp_path / "run" / "data_20200101_101010.csv")
    assert (name, notes) == ("utias_20200101_101010", [])
    assert list(tidy["phase"]) == ["TAKEOFF", "HOVER", "LAND"]
    assert list(tidy["t"]) == [0.0, 0.0163, 0.04]
    assert tidy["cmd_thrust_pwm"][0] == 40000.3


@pytest.mark.parametrize(
    ("name", "path", "flight"),
    [
        ("crazypad", "data/motor_data/heavy_flight/E8_log07", "pad_E8_heavy_flight_log07"),
        ("arp_sysid", "logs_crazyflie/log16", "arp_log16a"),
    ],
)
def test_micro_sd_logs(tmp_path, name, path, flight):
    columns = public_sets()[name].columns
    t = np.arange(0.0, 40.0, 0.5)  # the log's clock begins at 5 s
    values = {of["from"]: np.full(len(t), 2.0) for of in columns.values() if "from" in of}
    values.pop("stateEstimate.yaw", None)  # not logged in every flight of crazypad
    file = tmp_path / path
    file.parent.mkdir(parents=True)
    file.write_bytes(sd_card(values, t, 2, {"more": 1.0}))
    found, tidy, _ = convert(name, file)
    assert found == flight
    assert tidy["t"][0] == 0.0
    if name == "arp_sysid":
        assert tidy["t"].iloc[-1] == 10.0  # the segment from 31 to 41 s
        assert tidy["imu_wz"][0] == round(math.radians(2.0), 4)
    else:
        assert tidy["yaw"].isna().all()
        assert tidy["vbat"][0] == 0.002
        assert tidy["az"][0] == round(2 * 9.80665, 3)


def test_command_writes_flights_that_can_be_read_once_each(tmp_path, capsys):
    m = 300
    t = np.arange(m) / 100
    wave = np.sin(4.0 * t)
    table = original(
        "nanobench",
        m,
        t=t,
        px=-0.05 * wave,
        py=0.05 * wave,
        pz=1.0 + 0.01 * t,
        qw=np.ones(m),
        qx=0.04 * wave,
        qy=0.04 * wave,
        pid_controller_roll=5.0 * wave,
        pid_controller_pitch=-5.0 * wave,
        pid_controller_cmd_thrust=45000.0 + 100 * wave,
        pwr_pm_vbat=4.0 - 0.01 * t,
    )
    for name in ("a", "b"):
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    out = tmp_path / "out"
    files = [str(tmp_path / "a.csv"), str(tmp_path / "b.csv")]
    assert main(["flights", "nanobench", *files, "--out", str(out)]) == 0
    assert "same flight" in capsys.readouterr().err
    assert sorted(p.name for p in out.iterdir()) == ["nb_a.csv.gz", "source.txt"]
    assert "BSD-3-Clause" in (out / "source.txt").read_text()
    log = read_log(out / "nb_a.csv.gz", check=False)
    # ZYX angles of the firmware as ZXY ones: apart by half of 0.087^3.
    np.testing.assert_allclose(log.command[:, 2], np.radians(5.0) * wave, atol=0.5 * 0.0873**3 + 1e-5)
    assert log.voltage[0] == 4.0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nobody", "f.csv", "--out", "{0}/o"], "choose from"),
        (["nanobench", "{0}/f.csv"], "--out DIR"),
        (["nanobench", "{0}/f.csv", "--out", "{0}/o"], "lacks the column"),
        (["nanobench", "{0}/none.csv", "--out", "{0}/o"], "no such flight log"),
        (["utias_fmpc", "{0}/f.csv", "--out", "{0}/o"], "hardware_data"),
        (["nanobench", "{0}/f.csv", "--out", "{0}"], "not empty"),
    ],
)
def test_wrong_input_is_one_sentence(tmp_path, capsys, words, says):
    (tmp_path / "f.csv").write_text("t,px\n0,1\n1,2\n")
    assert main(["flights", *(w.format(tmp_path) for w in words)]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
    assert not (tmp_path / "o").exists()


def test_without_arguments_it_says_where_the_sets_are(capsys):
    assert main(["flights"]) == 0
    text = capsys.readouterr().out
    for known in public_sets().values():
        assert known.repository in text and known.licence in text
