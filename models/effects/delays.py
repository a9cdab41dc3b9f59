"""Dead times between a command and its effect, and between the vehicle's motion and its measurement."""

from inclined_landing.models.effects.effect import Effect, Parameter


def _delay(name: str, longest: float, plausible: float, negligible: float) -> Parameter:
    """Return the parameter of a delay."""
    return Parameter(
        "delay",
        unit="s",
        bounds=(0.0, longest),
        plausible=plausible,
        negligible=negligible,
        one_signed=True,
        reported=name,
    )


EFFECTS = (
    Effect(
        name="thrust_delay",
        description="The PWM command acts later than it was sent because of radio, queues and the "
        "firmware's loop.",
        formula="PWM(t - delay) in the equations of thrust and lag",
        source="radio links of the Crazyflie: 2 to 20 ms; streams of the nanobench flights up to 35 ms apart",
        parameters=(_delay("thrust delay", 0.15, 0.02, 0.002),),
        regimes=("climb",),
        confused_with=("motor_lag", "spin_down", "mocap_delay"),
        remedy="Send commands at 100 Hz or more with a fresh radio channel, lower the load of the link, or "
        "predict the state by the delay before computing a command.",
        channels=("translation",),
        is_lag=True,
        of_the_drive=True,
        says="thrust commands act {delay} after they were sent",
    ),
    Effect(
        name="attitude_delay",
        description="The roll, pitch and yaw rate commands act later than they were sent.",
        formula="roll, pitch and yaw rate command (t - delay) in the attitude loops",
        source="radio links of the Crazyflie; about 60 ms in the utias_fmpc flights",
        parameters=(_delay("attitude delay", 0.2, 0.04, 0.004),),
        regimes=("attitude_step", "lateral"),
        confused_with=("second_order_attitude", "attitude_time_constant", "mocap_delay"),
        remedy="Send commands at 100 Hz or more with a fresh radio channel, lower the load of the link, or "
        "predict the state by the delay before computing a command.",
        channels=("attitude", "yaw"),
        is_lag=True,
        says="attitude commands act {delay} after they were sent",
    ),
    Effect(
        name="mocap_delay",
        description="The measured position and attitude are older than their time stamp: processing and "
        "network of the motion capture system. The flight itself is unchanged, but measurements are late "
        "for the log and for controllers.",
        formula="measured(t) = state(t - delay)",
        source="motion capture over a network: 4 to 20 ms",
        parameters=(_delay("mocap delay", 0.15, 0.02, 0.002),),
        regimes=("attitude_step", "lateral", "climb"),
        confused_with=("thrust_delay", "attitude_delay"),
        remedy="Use the capture time stamps of the cameras instead of the time of arrival, or shift the log.",
        channels=("translation", "attitude", "yaw"),
        is_lag=True,
        says="the measured pose is {delay} older than its time stamp",
    ),
    Effect(
        name="estimator_delay",
        description="The logged attitude is older than the logged position: the onboard estimator lags, or "
        "it is logged by a different path than the motion capture. Drag appears larger than it is, "
        "because the tilt that brakes the vehicle is logged later.",
        formula="measured attitude(t) = attitude(t - delay), measured position(t) = position(t)",
        source="stream offsets of the nanobench flights: -20 to 35 ms",
        parameters=(
            Parameter(
                "delay",
                unit="s",
                bounds=(-0.06, 0.06),
                plausible=0.02,
                negligible=0.003,
                reported="estimator delay",
            ),
        ),
        regimes=("attitude_step", "lateral"),
        confused_with=("rotor_drag", "body_drag", "attitude_delay"),
        remedy="Log attitude and position with one clock, or shift the attitude of the log.",
        channels=("translation", "attitude"),
        is_lag=True,
        says="the logged attitude is {delay} older than the logged position",
    ),
)
