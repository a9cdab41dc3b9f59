"""A dead man's switch: a process of its own that stops the motors when the pilot's process is gone.

After `kill -9`, a crash in somebody else's library, or when the kernel ends it for want of memory, nothing of
the pilot runs any more, and the firmware holds the last thrust until its watchdog ends it 1 s later. But the
kernel closes the pipe to this process at once.
"""

from __future__ import annotations

import contextlib
import select
import subprocess
import sys
import time

from inclined_landing.models.errors import UserError

STARTING = 20.0  # s that the process may take until it listens
OPENING = (
    5.0  # s for which the link is tried: the Crazyradio may still be on its way back from the dead process
)
SENDING, PERIOD = 1.0, 0.01  # s for which the stop is sent, and how often: any packet may get lost
# Port, channel, data: stop (`crtp_commander_generic.c`) and emergency stop (`crtp_supervisor.c`, and before
# protocol 12 `crtp_localization_service.c`). None of them needs more than an open link.
STOPS = ((7, 0, b"\x00"), (9, 1, b"\x03"), (6, 1, b"\x03"))
_READY, _OVER = b"ready\n", b"over\n"


class DeadManSwitch:
    """Context in which the motors of the vehicle at `uri` are stopped when this process dies.

    Raises UserError on entering where the other process does not start.
    """

    def __init__(self, uri: str):
        self._uri = uri

    def __enter__(self) -> DeadManSwitch:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "inclined_landing.eval.flying.dead_man", self._uri],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # what the terminal sends to the pilot is not meant for it
        )
        output = self._process.stdout
        assert output is not None
        data = select.select([output], [], [], STARTING)[0]
        if not data or output.readline() != _READY:
            self._process.kill()
            self._process.communicate()
            raise UserError(
                "not ready to fly: the process that stops the motors should this one die has not started"
            )
        return self

    def __exit__(self, *_) -> None:
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            self._process.communicate(_OVER, timeout=STARTING)


def stop(uri: str) -> None:
    """Send stop commands to the vehicle at `uri` for a while. Raises what cflib does without a link."""
    import cflib.crtp
    from cflib.crtp.crtpstack import CRTPPacket

    end = time.monotonic() + OPENING
    while True:
        try:
            link = cflib.crtp.get_link_driver(uri, lambda *_: None, lambda *_: None)
            break
        except Exception:
            if time.monotonic() > end:
                raise
            time.sleep(PERIOD)
    end = time.monotonic() + SENDING
    while time.monotonic() < end:
        for port, channel, data in STOPS:
            packet = CRTPPacket(data=data)
            packet.set_header(port, channel)
            link.send_packet(packet)
        time.sleep(PERIOD)


def main(uri: str) -> None:
    """Wait for the end of standard input; stop the motors where it ends without the agreed last word."""
    import cflib.crtp

    cflib.crtp.init_drivers()
    sys.stdout.buffer.write(_READY)
    sys.stdout.buffer.flush()
    if sys.stdin.buffer.read() != _OVER:
        print("the pilot's process is gone: motors off", file=sys.stderr)
        stop(uri)


if __name__ == "__main__":
    main(sys.argv[1])
