"""Effects on how fast the thrust follows its command."""

from inclined_landing.models.effects.effect import Effect, Parameter

EFFECTS = (
    Effect(
        name="motor_lag",
        description="The motors reach their speed more slowly or faster than modelled; the steady thrust is "
        "the same. Heavier propellers and worn brushes slow them down.",
        formula="dOmega/dt = PWM - (lag_rate/scale) Omega,  F_t = (state_gain/scale) Omega + direct_gain PWM",
        source="Kooi and Babuska 2021: first-order motor function, 65 ms",
        parameters=(
            Parameter(
                "scale",
                neutral=1.0,
                bounds=(0.2, 5.0),
                plausible=1.5,
                negligible=0.08,
                fields=("thrust_lag_rate", "thrust_state_gain"),
                inverse=True,
                reported="thrust lag",
            ),
        ),
        regimes=("climb",),
        confused_with=("thrust_delay", "spin_down"),
        remedy="Check propellers and motors for drag (hair in the bearing, a bent shaft). Fly steps of "
        "thrust to distinguish a lag from a pure delay.",
        channels=("translation",),
        is_lag=True,
        of_the_drive=True,
        says="the motors' time constant is {scale} times the modelled one",
    ),
    Effect(
        name="spin_down",
        description="The motors slow down more slowly than they speed up, because only the air brakes them.",
        formula="dOmega/dt divided by (1 + excess) while it is negative",
        source="brushed motors without active braking",
        parameters=(Parameter("excess", bounds=(-0.6, 6.0), plausible=1.0, negligible=0.1, one_signed=True),),
        regimes=("climb",),
        confused_with=("motor_lag", "thrust_delay", "thrust_bias"),
        remedy="No repair is needed. Brake earlier in descents; steps of thrust up and down distinguish it "
        "from a symmetric lag.",
        channels=("translation",),
        is_lag=True,
        of_the_drive=True,
        says="the motors' time constant is larger by a share of {excess} while they slow down",
    ),
)
