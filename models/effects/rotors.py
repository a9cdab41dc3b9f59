"""Effects of single rotors, which are visible if the commands of all four motors were logged."""

from collections.abc import Mapping

from inclined_landing.models.effects.effect import Effect, Parameter
from inclined_landing.models.vehicle import Vehicle

_PLACES = ("front right", "back right", "back left", "front left")
_TURNS = (-1.0, 1.0, -1.0, 1.0)  # sign of the reaction torque: M2 and M4 turn clockwise
_NAMES = tuple(f"weak_rotor_{k}" for k in range(1, 5))


def _weak_rotor(k: int) -> Effect:
    """Return the effect of the rotor M1 to M4, k from 0."""

    def apply(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
        # Losses of one rotor multiply: 1 - loss. At the thrust that it had before, its torque is
        # (1 - torque loss)/(1 - loss) times as large: the requests differ in yaw by s loss (torque - 1)/4.
        losses, loss = list(vehicle.effects_rotor_loss), values.get("loss", 0.0)
        losses[k] = 1.0 - (1.0 - losses[k]) * (1.0 - loss)
        turn = 0.25 * _TURNS[k] * loss * (values.get("torque", 1.0) - 1.0)
        return vehicle.changed(
            effects_rotor_loss=tuple(losses), effects_yaw_imbalance=vehicle.effects_yaw_imbalance + turn
        )

    return Effect(
        name=_NAMES[k],
        description=f"The rotor of motor M{k + 1} ({_PLACES[k]}) gives less thrust than the others at the "
        "same request: a cut or worn propeller, a weak motor. The controller requests more from it, and "
        "from some of the others to balance the yawing moment, which a weight at its arm would not change.",
        formula="f_i = F_t/4 (1 - loss) of this rotor, its reaction torque 1 - torque loss times as large; "
        "request r_i ~ (1 + relative torques)/(1 - loss)",
        source="momentum theory: thrust with the fourth power of the propeller's diameter; CrazyPAD, data "
        "2024: propellers cut by up to 8 mm",
        parameters=(
            Parameter(
                "loss",
                bounds=(-0.03, 0.6),
                plausible=0.12,
                negligible=0.01,
                one_signed=True,
                fields=(f"effects_rotor_loss.{k}",),
            ),
            # Torque lost over thrust lost: 1 of a weak motor; of a cut propeller, whose thrust goes with the
            # fourth power of the diameter and whose torque with the fifth, 1.25 and more (CrazyPAD: 2).
            Parameter(
                "torque", neutral=1.0, bounds=(0.0, 2.2), plausible=1.25, negligible=0.1, is_reference=True
            ),
        ),
        regimes=("hover", "climb", "lateral"),
        confused_with=(*(n for n in _NAMES if n != _NAMES[k]), "com_offset", "yaw_imbalance", "thrust_scale"),
        remedy=f"Replace the propeller of M{k + 1}, and clean or replace its motor.",
        channels=("translation", "attitude", "requests"),
        apply=apply,
        says=f"the {_PLACES[k]} rotor has lost a share of {{loss}} of its thrust and {{torque}} "
        "times as much of its torque",
        requires={"request_differences": 0.0},
        identified=False,
    )


EFFECTS = (
    *(_weak_rotor(k) for k in range(4)),
    Effect(
        name="yaw_imbalance",
        description="The motors of one direction of rotation get higher commands than the others while the "
        "vehicle keeps its heading: propellers of unequal drag, or tilted motors. It does not change the "
        "motion.",
        formula="(r_2 + r_4 - r_1 - r_3) / (r_1 + r_2 + r_3 + r_4) = share in hover",
        source="balance of the turning moment; up to 0.1 in the CrazyPAD flights",
        parameters=(Parameter("share", bounds=(-0.3, 0.3), plausible=0.03, negligible=0.003),),
        regimes=("hover",),
        confused_with=_NAMES,
        remedy="It only reduces the control range. Swap propellers between the two directions, and align the "
        "motors.",
        channels=("requests",),
        says="the requests of the motors differ in yaw by a share of {share}",
        requires={"request_differences": 0.0},
    ),
)
