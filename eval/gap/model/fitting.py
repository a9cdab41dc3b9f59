"""Settings for fitting effects, in addition to their physics.

Numbers were chosen on the development families of docs/evidence/hidden_effects.md. An effect without an entry
is fitted from neutral, has no model errors of its own, and varies by what is negligible.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping


@dataclasses.dataclass(frozen=True)
class Variation:
    """The variation [unit] of a parameter's best fit, for the shipped vehicle."""

    manoeuvre: float = 0.0  # with how one vehicle is flown: no loop is quite of its form
    # Between flights of one vehicle, where the motors' requests show it: these move by 3 to 4 % each from day
    # to day (CrazyPAD), half of it in every difference of all four. Flights of one day share it.
    placement: float = 0.0
    step: float = 0.0  # over which a fit takes slopes; 0: negligible

    def __mul__(self, times: float) -> Variation:
        """Return the variation of a vehicle whose sizes are so many times as large."""
        return Variation(self.manoeuvre * times, self.placement * times, self.step * times)


@dataclasses.dataclass(frozen=True)
class Fitting:
    """Settings for fitting an effect."""

    # Values that a fit begins at too: where an effect is not linear, its slopes at neutral may mislead.
    starts: tuple[Mapping[str, float], ...] = ()
    # Errors of its formula that are free while it is named (see `columns`), and the standard deviation of
    # their weights.
    forms: tuple[str, ...] = ()
    form: float = 0.05
    # Standard deviation of the logarithm of its size, as what it acts by was identified in other conditions.
    extrapolated: float = 0.0
    same_as: tuple[str, ...] = ()  # effects that, together and of its size, are the same to every flight
    parameters: Mapping[str, Variation] = dataclasses.field(default_factory=dict)


def fitting(effect: str) -> Fitting:
    """Return how an effect is fitted."""
    return FITTING.get(effect, Fitting())


def _delay(manoeuvre: float = 0.0) -> dict[str, Variation]:
    # All have the same step: where their slopes bend, at whole rows of a log, they stay sums of each other.
    return {"delay": Variation(manoeuvre, step=0.001)}


_DELAYS = tuple({"delay": delay} for delay in (0.01, 0.025, 0.05, 0.08))
_LOADS = tuple(
    {"mass": m, "length": length} for m in (0.0015, 0.004) for length in (0.12, 0.2, 0.3, 0.5, 0.8)
)
_ROTOR = Fitting(forms=("requests slope",), form=0.2, parameters={"loss": Variation(placement=0.015)})
FITTING = {
    "thrust_delay": Fitting(starts=_DELAYS, parameters=_delay()),
    "attitude_delay": Fitting(starts=_DELAYS, parameters=_delay(0.008)),
    "mocap_delay": Fitting(
        starts=_DELAYS, same_as=("thrust_delay", "attitude_delay"), parameters=_delay(0.007)
    ),
    "estimator_delay": Fitting(parameters=_delay(0.003)),
    "slung_load": Fitting(starts=_LOADS),
    # Its speed follows from its force by a drag that was identified at other air speeds: speeds of fans came
    # out 1.3 to 1.7 times as high, one in another simulator twice.
    "wind": Fitting(extrapolated=0.3),
    "rotor_drag": Fitting(forms=("translation speed", "translation late"), form=0.15),
    "com_offset": Fitting(
        starts=({"hold": 0.002},),
        forms=("requests slope",),
        form=0.2,
        parameters=dict.fromkeys("xy", Variation(placement=2e-4)),
    ),
    "attitude_time_constant": Fitting(
        starts=({"scale": 0.6}, {"scale": 1.7}, {"scale": 2.7}), parameters={"scale": Variation(0.12)}
    ),
    "second_order_attitude": Fitting(
        forms=("attitude late",), form=0.2, parameters={"rate_lag": Variation(0.015)}
    ),
    "attitude_integral": Fitting(parameters={"rate": Variation(0.1)}),
    "attitude_saturation": Fitting(parameters={"inverse": Variation(step=0.4)}),
    "yaw_loop": Fitting(parameters={"gain": Variation(0.05), "time_constant": Variation(0.3)}),
    **{f"weak_rotor_{k}": _ROTOR for k in range(1, 5)},
    "yaw_imbalance": Fitting(parameters={"share": Variation(placement=0.003)}),
}
