"""The learning curves as TensorBoard's event files."""

from __future__ import annotations

from pathlib import Path

from stable_baselines3.common.logger import TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter


class EventFile(TensorBoardOutputFormat):
    """A new event file of numbers, as Stable-Baselines3 writes it."""

    def __init__(self, folder: Path, resumed_at: int | None = None):
        """resumed_at: steps of the checkpoint; later numbers in earlier files of the folder are hidden."""
        purge = None if resumed_at is None else resumed_at + 1
        self.writer = SummaryWriter(str(folder), purge_step=purge)
        self._is_closed = False
