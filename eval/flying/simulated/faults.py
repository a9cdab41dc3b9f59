"""What can go wrong in a flight, and when: `mocap-frozen@12.5` or, after an event, `mocap-frozen@air+2`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from inclined_landing.models.errors import UserError, shown

if TYPE_CHECKING:
    from inclined_landing.eval.flying.simulated.world import World

SWAP = 0.3  # m by which the pose jumps when markers are swapped
BURST_LOSS, BURST_LENGTH = 0.9, 1.0  # share of the packets lost, both ways, and for how long [s]
DEAD_MAN_DELAY = 0.12  # s from the pilot's end to the stop of `dead_man`: the slowest of six over UDP
SAG_RATE, FLAT = 0.5, 2.8  # V/s by which a failing battery falls, down to this voltage
EVENTS = ("start", "air", "low", "near")


def _set(name: str, **changes) -> Callable[[World], None]:
    """Return a fault that permanently sets attributes of a part of the world."""

    def begin(world: World) -> None:
        for key, value in changes.items():
            setattr(getattr(world, name), key, value)

    return begin


def _link_lost(world: World) -> None:
    world.up.down = world.down.down = True
    link = world.up.link
    world.schedule(world.time + link.attempts * link.again, world.report_link_lost)


def _killed(world: World) -> None:
    world.up.down = world.down.down = True
    world.schedule(world.time + DEAD_MAN_DELAY, lambda: world.firmware.stop_now())


def _storm(world: World) -> None:
    world.up.storm = world.down.storm = BURST_LOSS

    def end() -> None:
        world.up.storm = world.down.storm = 0.0

    world.schedule(world.time + BURST_LENGTH, end)


def _swap(world: World) -> None:
    direction = world.random.normal(size=3)
    world.view.shift = SWAP * direction / math.sqrt(direction @ direction)


# Name: what it is, and what begins.
FAULTS: dict[str, tuple[str, Callable[[World], None]]] = {
    "link-lost": ("no packet gets through, either way; cflib's driver gives up soon after", _link_lost),
    "pilot-killed": (
        f"the pilot's process is gone; the one that outlives it sends a stop {DEAD_MAN_DELAY:g} s later",
        _killed,
    ),
    "uplink-lost": ("set-points do not arrive; the log goes on", _set("up", down=True)),
    "downlink-lost": ("the log stops; set-points arrive", _set("down", down=True)),
    "packet-storm": (f"{BURST_LOSS:.0%} of the packets are lost for {BURST_LENGTH:g} s, both ways", _storm),
    "mocap-lost": ("the cameras see nothing any more", _set("view", blind=True)),
    "mocap-frozen": ("the same pose again and again, with new times", _set("view", frozen=True)),
    "mocap-stuck": ("a marker left behind: the pose stays where it was", _set("view", stuck=True)),
    "marker-swap": (f"the pose jumps by {SWAP:g} m in a random direction", _swap),
    "attitude-turned": ("the pose shows the vehicle turned by half a turn", _set("view", turned=True)),
    "deck-blind": (
        "the Lighthouse or Flow deck sees nothing any more: the onboard position is added up",
        _set("deck", blind=True),
    ),
    "attitude-wrong": ("the onboard roll and pitch have the wrong sign", _set("sensors", sign=-1.0)),
    "low-battery": (
        f"the voltage falls by {SAG_RATE:g} V/s, and the thrust with it",
        _set("sensors", failing=True),
    ),
    "reboot": ("the vehicle restarts: motors off, link lost", lambda world: world.reboot()),
}


@dataclasses.dataclass(frozen=True)
class Fault:
    """One fault of FAULTS, `after` seconds [s] after an event.

    start: 1 s after the vehicle was switched on; air: its feet leave the floor; near: it comes
    within 0.5 m of the platform's centre after having been farther; low: it was above 0.3 m and sinks below.
    """

    name: str
    event: str = "start"
    after: float = 0.0

    @staticmethod
    def parse(text: str) -> Fault:
        """Return the fault NAME, NAME@SECONDS or NAME@EVENT+SECONDS. Raises UserError."""
        name, at, when = text.partition("@")
        if name not in FAULTS:
            raise UserError(f"unknown fault {shown(name, 40)}; known are {', '.join(FAULTS)}")
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

    def begin(self, world: World) -> None:
        """Begin the fault now."""
        FAULTS[self.name][1](world)

    def __str__(self) -> str:
        return f"{self.name}@{self.event}+{self.after:g}"
