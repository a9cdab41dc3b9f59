"""A pilot's process is killed in flight: another process stops the motors. By cflib over UDP."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time

import pytest

pytest.importorskip("cflib", reason="the extra fly is not installed")

from inclined_landing.eval.flying import watchdog
from inclined_landing.eval.flying.watchdog import DeadManSwitch
from inclined_landing.models.base.errors import UserError

# Stop, emergency stop and that of older firmware: port, channel and two bits that are set in a byte, data.
STOP = {b"\x7c\x00", b"\x9d\x03", b"\x6d\x03"}


class Listener:
    """A socket in the place of a vehicle."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.uri = f"udp://127.0.0.1:{self.socket.getsockname()[1]}"

    def heard(self, seconds):
        """Every packet until that many seconds are silent."""
        self.socket.settimeout(seconds)
        packets = set()
        with contextlib.suppress(TimeoutError):
            while True:
                packets.add(self.socket.recv(64))
        return packets


HOLDER = """
import os, sys
from inclined_landing.eval.flying.watchdog import DeadManSwitch
with DeadManSwitch(sys.argv[1]):
    if sys.argv[2] == "dies":
        os.kill(os.getpid(), 9)
"""


def test_the_other_process_imports_nothing_from_the_current_folder(tmp_path, monkeypatch):
    for name in ("usb", "struct", "cflib"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('imported from the current folder')\n")
    monkeypatch.chdir(tmp_path)
    with DeadManSwitch("udp://127.0.0.1:1") as switch:
        assert switch.watches()


@pytest.mark.parametrize("end", ["dies", "returns"])
def test_the_switch_sends_the_stop_when_its_process_dies_and_only_then(end):
    listener = Listener()
    done = subprocess.run(
        [sys.executable, "-P", "-c", HOLDER, listener.uri, end], capture_output=True, timeout=60
    )
    assert done.returncode == (-9 if end == "dies" else 0), done.stderr
    assert listener.heard(0.1) == (STOP if end == "dies" else set())
    listener.socket.close()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_switch_that_is_killed_or_stopped_watches_no_more_and_is_left_soon(number, monkeypatch):
    monkeypatch.setattr(watchdog, "ENDING", 0.2)
    with DeadManSwitch("udp://127.0.0.1:1") as switch:
        assert switch.watches()
        os.kill(switch._process.pid, number)
        end = time.monotonic() + 20.0
        while switch.watches():
            assert time.monotonic() < end
            time.sleep(0.01)
    assert switch._process.returncode == -signal.SIGKILL and not switch.watches()


def test_no_flight_without_the_switch(monkeypatch):
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    with pytest.raises(UserError, match="has not started"), DeadManSwitch("udp://127.0.0.1:1"):
        pytest.fail("entered")
