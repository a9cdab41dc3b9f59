"""Gymnasium's own wrappers around the environments."""

import gymnasium as gym
import imageio_ffmpeg
import numpy as np
import pytest
from gymnasium import wrappers

import inclined_landing.envs  # noqa: F401 (registers the environments)
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
