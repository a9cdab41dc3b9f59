"""The TensorBoard event file of a training run, with its learning curves."""

from __future__ import annotations

import contextlib
import os
import secrets
import time
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.logger import KVWriter
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError


class EventFile(KVWriter):
    """A new event file of numbers, written in the calling thread.

    TensorBoard's own writer uses a thread, whose error on a full disk does not reach the caller. Raises
    UserError, with the file's name, if the file cannot be written.
    """

    def __init__(self, folder: Path, resumed_at: int | None = None):
        """resumed_at: steps of the checkpoint; later numbers in earlier files of the folder are hidden."""
        # TensorBoard reads files in the order of their names: the time in them tells two of one second apart.
        name = f"events.out.tfevents.{time.time():.6f}.{os.uname().nodename}.{secrets.token_hex(4)}"
        self.path = folder / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("wb")
        except OSError as error:
            raise self._refused(error) from error
        self._records = RecordWriter(self._file)
        self._add(Event(file_version="brain.Event:2"))
        if resumed_at is not None:
            self._add(Event(step=resumed_at + 1, session_log=SessionLog(status=SessionLog.START)))

    def write(self, key_values: dict[str, Any], key_excluded: dict, step: int = 0) -> None:
        """Write the numbers of one iteration, except those excluded from TensorBoard's files."""
        numbers = [
            Summary.Value(tag=key, simple_value=float(value))
            for key, value in sorted(key_values.items())
            if isinstance(value, (int, float, np.number)) and "tensorboard" not in (key_excluded[key] or ())
        ]
        self._add(Event(step=step, summary=Summary(value=numbers)))

    def _add(self, event: Event) -> None:
        event.wall_time = time.time()
        try:
            self._records.write(event.SerializeToString())
            self._records.flush()
        except OSError as error:
            raise self._refused(error) from error

    def _refused(self, error: OSError) -> UserError:
        return UserError(f"cannot write {self.path}: {storage.reason(error)}")

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):  # of what could not be written before, which has been said
            self._file.close()
