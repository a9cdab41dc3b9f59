"""Gymnasium's own wrappers around the environments, and the window of human mode."""

import shutil
import subprocess
import sys

import gymnasium as gym
import imageio_ffmpeg
import numpy as np
import pytest
from gymnasium import wrappers

import inclined_landing.envs  # noqa: F401 (registers the environments)
from inclined_landing.envs.rendering import window
from inclined_landing.models.base.errors import UserError

ID = "InclinedLanding-v0"
PICTURE = {"render_mode": "rgb_array", "width": 96, "height": 64, "render_backend": "ray"}


@pytest.mark.slow
def test_record_video_writes_a_film_that_plays(tmp_path):
    pytest.importorskip("moviepy", reason="moviepy is not installed")
    env = wrappers.RecordVideo(gym.make(ID, plant="analytic", **PICTURE), str(tmp_path), disable_logger=True)
    env.reset(seed=0)
    for _ in range(4):
        env.step(env.action_space.sample())
    env.close()
    (film,) = tmp_path.glob("*.mp4")
    reader = imageio_ffmpeg.read_frames(str(film))
    meta = next(reader)
    assert tuple(meta["size"]) == (96, 64) and meta["fps"] == pytest.approx(50)
    assert len(list(reader)) == 5


def test_resets_can_be_left_to_the_user():
    plain = gym.make_vec(ID, num_envs=2, plant="analytic", autoreset_mode="Disabled")
    plain.reset(seed=1)
    for _ in range(300):
        *_, truncated, _ = plain.step(np.zeros((2, 2)))
    assert truncated.all()
    with pytest.raises(UserError, match=r"vehicles \[0, 1\] have ended; reset them"):
        plain.step(np.zeros((2, 2)))
    plain.reset(options={"reset_mask": np.array([True, True])})
    assert not plain.step(np.zeros((2, 2)))[3].any()
    with pytest.raises(UserError, match="autoreset_mode must be one of"):
        gym.make_vec(ID, num_envs=2, autoreset_mode="sometimes")


# --- the window ----------------------------------------------------------------------------------------


def test_without_a_display_the_window_says_what_to_do(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(window.sys, "platform", "linux")
    for opened in (window.check_display, window.Window, lambda: gym.make(ID, render_mode="human")):
        with pytest.raises(UserError, match=r"needs a display.*landing-eval replay.*rgb_array"):
            opened()


HUMAN = """
import gymnasium, numpy, time
env = gymnasium.make("inclined_landing.envs:InclinedLanding-v0", render_mode="human", plant="analytic")
env.reset(seed=0)
window = env.unwrapped._window
state = env.unwrapped.batch.plant.state
for _ in range(2):
    env.step(env.action_space.sample())
    assert window.open and abs(window.data.qpos[:3] - state[0, :3]).max() == 0.0
assert env.render() is None
window.close()  # as a person would
env.step(env.action_space.sample())
assert not window.open
env.close()
env.close()
print("clean")
"""


@pytest.mark.slow
@pytest.mark.gl
def test_a_window_opens_follows_and_closes_cleanly():
    """On a virtual display with OpenGL in software: seconds for a picture."""
    if shutil.which("xvfb-run") is None:
        pytest.skip("no virtual display here (Debian: apt-get install xvfb)")
    screen = ["xvfb-run", "-a", "-s", "-screen 0 320x240x24"]
    done = subprocess.run([*screen, sys.executable, "-c", HUMAN], capture_output=True, text=True, timeout=500)
    assert done.returncode == 0 and done.stdout.endswith("clean\n"), done.stderr
