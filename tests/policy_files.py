"""Policy files for tests: of a model whose environment is none of a task, and with other metadata."""

import json
import zipfile
from pathlib import Path

from inclined_landing.envs.policy_file import METADATA
from inclined_landing.envs.save import actor_of, write_policy


def written(path: Path, model, metadata: dict) -> Path:
    """Write a policy file as training does; return its path."""
    write_policy(model, path, metadata, actor_of(model))
    return path


def restamp(path: Path, metadata: dict) -> None:
    """Replace what a policy file says of its training, or add it to a file of Stable-Baselines3 alone."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    before = json.loads(members.get(METADATA, "{}"))
    members[METADATA] = json.dumps({k: v for k, v in before.items() if k == "network"} | metadata).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
