"""A pilot's process is killed in flight: the vehicle, a process of its own, must come down by itself."""

import re
import signal
import socket
import subprocess
import sys
import time

import pytest

pytest.importorskip("cflib", reason="the extra fly is not installed")

EVAL = (sys.executable, "-m", "inclined_landing.eval")
# s: the firmware's 2 s and one period of its supervisor, a control period, and what two processes on a busy
# machine are late by.
LIMIT = 2.0 + 0.04 + 0.02 + 0.4


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def awaited(process, pattern, patience=60.0):
    """The first line of its output that has the pattern, with the time at which it was printed [s]."""
    end = time.monotonic() + patience
    for line in process.stdout:
        if re.search(pattern, line):
            return float(line.split()[0]) if line.split()[0].replace(".", "").isdigit() else 0.0
        if time.monotonic() > end:
            break
    raise AssertionError(f"{pattern!r} was not printed within {patience:g} s")


@pytest.mark.slow
@pytest.mark.parametrize("after", [2.0, 6.0])
def test_motors_stop_and_the_vehicle_comes_down(after, tmp_path):
    port, poses = free_port(), free_port()
    words = ("crazyflie", f"--port={port}", f"--poses=127.0.0.1:{poses}", "--seconds=120")
    vehicle = subprocess.Popen([*EVAL, *words], stdout=subprocess.PIPE, text=True)
    pilot = None
    try:
        awaited(vehicle, "udp://")
        words = ("fly", f"--uri=udp://127.0.0.1:{port}", f"--mocap=poses:127.0.0.1:{poses}", "--yes")
        pilot = subprocess.Popen([*EVAL, *words, f"--out={tmp_path / 'flights'}"], stdout=subprocess.DEVNULL)
        began = awaited(vehicle, "motors on")
        time.sleep(after)
        assert pilot.poll() is None, "the pilot ended before it was killed"
        pilot.send_signal(signal.SIGKILL)
        pilot.wait()
        off = awaited(vehicle, "motors off")
        # The vehicle's clock went on with this one since its motors were on.
        assert off - (began + after) <= LIMIT + 0.2  # the line "motors on" took some time to get here
        awaited(vehicle, "supervisor: locked")
        assert awaited(vehicle, "at rest on the (floor|platform)") - off < 3.0
    finally:
        for process in (pilot, vehicle):
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()
