"""Policies made of the shipped ones."""

import shutil
from pathlib import Path

from inclined_landing.envs import weights
from inclined_landing.envs.policy import load_policy, locate, write_metadata


def about_another_hover(name: str, folder: Path) -> str:
    """Write a shipped policy's network with actions about another PWM; return its path.

    What firmware compares of it is the same, what it commands is not.
    """
    path = Path(shutil.copyfile(locate(name), folder / "other.zip"))
    metadata = weights.read_metadata(path)
    metadata["task_options"]["pwm_centre"] = load_policy(name).task.pwm_centre + 1500.0
    write_metadata(path, metadata)
    return str(path)
