"""Faults of a flight and their times: `mocap-frozen@12.5` or, after an event, `mocap-frozen@air+2`."""

from __future__ import annotations

import dataclasses
import math

from inclined_landing.eval.flying.simulated.sensors import SAG_RATE
from inclined_landing.models.base.errors import UserError, shown

SWAP = 0.3  # m by which the pose jumps when markers are swapped
BURST_LOSS, BURST_LENGTH = 0.9, 1.0  # share of the packets lost, both ways, and for how long [s]
DEAD_MAN_DELAY = 0.12  # s from the pilot's end to the stop of `DeadManSwitch`: the slowest of six over UDP
EVENTS = ("start", "air")


FAULTS = {  # names and descriptions; `World.begin` starts them
    "link-lost": "no packet gets through, either way; cflib's driver gives up soon after",
    "pilot-killed": f"the pilot's process is gone; its watchdog sends a stop {DEAD_MAN_DELAY:g} s later",
    "uplink-lost": "set-points do not arrive; the log continues",
    "downlink-lost": "the log stops; set-points arrive",
    "packet-storm": f"{BURST_LOSS:.0%} of the packets are lost for {BURST_LENGTH:g} s, both ways",
    "mocap-lost": "the cameras see nothing any more",
    "mocap-frozen": "the same pose repeatedly, with new times",
    "mocap-stuck": "a marker left behind: the pose stays where it was",
    "marker-swap": f"the pose jumps by {SWAP:g} m in a random direction",
    "attitude-turned": "the pose shows the vehicle turned by half a turn",
    "deck-blind": "the Lighthouse deck sees nothing any more; the onboard position is dead reckoning",
    "attitude-wrong": "the onboard roll and pitch have the wrong sign",
    "low-battery": f"the voltage falls by {SAG_RATE:g} V/s, and the thrust with it",
    "reboot": "the vehicle restarts: motors off, link lost",
}


@dataclasses.dataclass(frozen=True)
class Fault:
    """One fault of FAULTS, `after` seconds [s] after an event.

    start: 1 s after the vehicle was switched on; air: its feet leave the floor.
    """

    name: str
    event: str = "start"
    after: float = 0.0

    @staticmethod
    def parse(text: str) -> Fault:
        """Return the fault NAME, NAME@SECONDS or NAME@EVENT+SECONDS. Raises UserError."""
        name, at, when = text.partition("@")
        if name not in FAULTS:
            raise UserError(f"unknown fault {shown(name, 40)}; choose from {', '.join(FAULTS)}")
        if not at:
            return Fault(name, "air", 1.0)
        event, plus, seconds = when.partition("+")
        if not plus:
            event, seconds = (when, "0") if when in EVENTS else ("start", when)
        try:
            after = float(seconds)
        except ValueError:
            after = math.nan
        if event not in EVENTS or not 0.0 <= after < 1e4:
            raise UserError(
                f"fault {shown(text, 60)}: expected NAME@SECONDS or NAME@EVENT+SECONDS, events "
                f"{', '.join(EVENTS)}"
            )
        return Fault(name, event, after)

    def __str__(self) -> str:
        return f"{self.name}@{self.event}+{self.after:g}"
