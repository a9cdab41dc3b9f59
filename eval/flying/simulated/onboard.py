"""The part of a C export's app that takes policies, on the simulated Crazyflie: its C code, compiled here.

The simulated vehicle does not fly these policies.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from inclined_landing.eval.export import compiled
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown


class OnboardApp:
    """The app of the C export in `folder`. Raises UserError where that is none, or there is no compiler."""

    def __init__(self, folder: Path):
        if not (folder / "src/landing_policy_file.c").is_file():
            raise UserError(
                f"{shown(folder)} is no C export; landing-eval export POLICY --format c writes one"
            )
        for file in (folder / "src").iterdir():
            storage.read_bytes(file, "source", storage.LARGEST_JSON)  # a compiler would wait for a pipe
        self._folder, self._starts = folder, 0
        self._scratch = tempfile.TemporaryDirectory()

    def start(self) -> Callable[[bytes, bool], bytes]:
        """Return the app just started: its reply to a packet, and to whether the vehicle flies.

        Each time its memory is fresh, as after a restart.
        """
        self._starts += 1
        scratch = Path(self._scratch.name, str(self._starts))
        scratch.mkdir()
        return compiled.Library(self._folder, scratch).receive
