"""Wrong input of commands: one sentence, exit code 2, and nothing is written."""

import pytest

from inclined_landing.eval import cli
from tests.campaign.inputs import flight
from tests.policy_files import hovering
from tests.refused import refused

# Command lines in a folder with a policy hover.zip, a log log.csv, a file and a full folder; part of what is
# said. Lines without --out get one.
REFUSED = {
    "success none.zip": "none.zip does not exist",
    "success hover.zip --task setpoint": "trained for the task landing, not for setpoint",
    "success hover.zip --task hover": "unknown task 'hover'",
    "success hover.zip --plant moon": "unknown plant 'moon'; choose from mujoco",
    "success hover.zip --inclination 80": "outside the supported range of -50 to 50 deg",
    "success hover.zip --vehicle none.toml": "vehicle file none.toml does not exist",
    "success hover.zip --out full": "exists and is not empty",
    "success hover.zip --seed -1": "--seed must be a whole number from 0 to 4294967295, not -1",
    "success touchdown": "is evaluated by landing-eval touchdown",
    "fly --simulated --position=gps": "invalid choice 'gps'",
    "export none.zip --format c": "does not exist",
    "export landing --format tflite": "choose from onnx, c",
    "robustness touchdown": "touchdown.zip is for touchdown",
    "robustness landing-slopes": "observes the slope",
    "robustness landing landing": "landing is named twice",
    "robustness landing --vehicle sparrow --over vehicles": "vehicle file sparrow does not exist",
    "robustness setpoint --over vehicles": "policy setpoint is for the task setpoint, not for landing",
    "robustness a=": "a policy must be POLICY or LABEL=POLICY",
    "robustness": "name at least one policy",
    "robustness --over moving landing-nominal": "flies in a plane",  # in any order
    "robustness --over moving thrust landing-nominal": "flies in a plane",
    "robustness landing --over moving thrst": "--over",
    "robustness touchdown-nominal --over moving": "flies in a plane",
    "robustness no-such-policy --over moving": "does not exist",
    "mission --landing touchdown": "the landing policy touchdown is for the task touchdown",
    "mission --start 1,2": "--start must be X,Y,Z in metres, not '1,2'",
    "mission --start 0,0,1.2": "start 0,0,1.2 lies within 0.25 m of the platform, under it",
    "mission --start 9,0,1": "outside the set-point task's starts (x -2.5 to 2.5",
    "mission --start=-1,0,1.5 --missions 5": "--missions has no effect with --start",
    "mission --hand-over 0,1": "the hand-over point must lie above the platform",
    "mission --width 161": "width and height of a video must be even, not",
    "touchdown touchdown --effect winds": "unknown effect winds",
    "video hover.zip --out a.avi": "--out must be an .mp4 or .gif file, not 'a.avi'",
    "video hover.zip --out a.mp4 --start 1,2,3": "--start must be X,Z in metres",
    "video hover.zip --out a.mp4 --start 9,1": "x must be between -3.4 and 3.4 m",
    "video hover.zip --out a.mp4 --start nan,1": "--start must be X,Z in metres",
    "video hover.zip --out a.mp4 --start 0,1": "--start 0,1 lies inside the platform",
    "video hover.zip --out a.mp4 --start 0.3,1.28": "lies inside the platform",
    "video hover.zip --out a.mp4 --width 641": "width and height of a video must be even",
    "video hover.zip --out a.mp4 --camera top": "unknown camera 'top'",
    "video hover.zip --out a.mp4 --until noon": "invalid choice 'noon'",
    "video hover.zip --out new/a.mp4 --backend pen": "unknown rendering backend 'pen'",
    "video hover.zip --out file/a.mp4 --width 64 --height 64": "cannot write into file: file is not a folder",
    "picture hover.zip --out a.jpg": "--out must be a .png file, not 'a.jpg'",
    "figure hover.zip --out file": "cannot write into file: file is not a folder",
    "replay --out page.html": "at least one policy or log",
    "replay landing --out page.pdf": "--out must be an .html file",
    "replay nowhere.csv --out page.html": "nowhere.csv",
    "replay nowhere.zip --out page.html": "policy nowhere.zip does not exist",
    "replay . --out page.html": ".",
    "replay log.csv --start 1,2 --out page.html": "--start has no effect without a policy",
    "replay landing --start 9,9 --out page.html": "outside the arena",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """The folder that the command lines are written for."""
    folder = tmp_path_factory.mktemp("place")
    hovering(folder / "hover.zip")
    (folder / "file").touch()
    (folder / "full").mkdir()
    (folder / "full" / "x").touch()
    (folder / "log.csv").write_text(flight())
    return folder


@pytest.mark.parametrize("line", REFUSED)
def test_wrong_input_is_one_sentence_and_writes_nothing(line, place, monkeypatch):
    monkeypatch.chdir(place)
    words = line.split() + ([] if "--out" in line else ["--out", "new"])
    refused(cli.main, words, REFUSED[line], place)
