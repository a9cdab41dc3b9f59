"""`landing-eval view`: MuJoCo's viewer with a policy's flights, in real time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from inclined_landing.eval.base.options import Flag, Flat, Flown, PolicyFile, Starts

if TYPE_CHECKING:
    from inclined_landing.envs.flights import Flight
    from inclined_landing.envs.rendering.window import Window

_FPS = 50.0  # moments shown in a second
_LINGERS = 1.5  # s that the last moment of a flight stays


def command(
    policy: PolicyFile,
    /,
    *,
    start: Starts = (),
    slow: Annotated[float, Meta(ge=0.1, le=100)] = 1.0,
    again: Flag = False,
    flown: Flat[Flown] = Flown(),
) -> None:
    """Show flights of a policy in MuJoCo's viewer in real time; needs a display.

    Closing the window ends the command.

    Args:
        policy: policy file, or name of a shipped policy.
        start: start of a flight in metres, X,Z or (setpoint) X,Y,Z; repeatable.
        slow: slow-down factor; 2 plays at half speed.
        again: repeat the flights until the window is closed.
    """
    from inclined_landing.envs.rendering.window import Window, check_display
    from inclined_landing.envs.shared.tables import say
    from inclined_landing.eval.pictures.flights import fly_from, say_outcome, start_points, succeeded

    loaded = flown.load(policy)
    where = start_points(start, loaded.task)
    check_display()
    flights = fly_from(loaded, where, flown.plant)
    with Window(loaded.task.vehicle) as window:
        first = True
        while window.open and (first or again):
            for k, flight in enumerate(flights):
                play(window, flight, flown.plant, slow)
                if first:
                    say_outcome(flight, f"flight {k + 1}")
            first = False
    say(f"{succeeded(flights)}.")


def play(window: Window, flight: Flight, plant: str, slow: float) -> None:
    """Show one flight in real time, `slow` times slower; stop when the window is closed.

    A landing is followed until the vehicle is at rest.
    """
    from inclined_landing.envs.flights import resimulate
    from inclined_landing.eval.pictures.to_rest import to_rest

    flight = to_rest(flight)
    steps = resimulate(flight) if plant == "mujoco" else flight
    platforms = [None] * len(steps.t) if steps.platform is None else steps.platform
    stride = max(1, round(1.0 / (_FPS * slow * (steps.t[1] - steps.t[0]))))
    rows = [*range(0, len(steps.t), stride), len(steps.t) - 1]
    waited = 0.0
    for k in rows:
        if not window.open:
            return
        text = f"t {steps.t[k]:.2f} s   PWM {steps.commands[k, 0]:.0f}"
        pause = slow * (steps.t[k] - waited)
        window.show(steps.state[k], steps.commands[k], platforms[k], text=text, seconds=pause)
        waited = steps.t[k]
    for _ in range(round(_LINGERS * _FPS)):
        if not window.open:
            return
        window.show(steps.state[-1], steps.commands[-1], platforms[-1], text=text, seconds=1.0 / _FPS)
