"""Effects on the attitude loops."""

from inclined_landing.models.effects.effect import Effect, Parameter

_QUICKEST = 0.002  # s, lag of a rate loop that the engine's step can follow
_LEAST_TIME = 0.0081  # s, of an attitude loop that a control step of 0.02 s can follow


def _time_constant(vehicle, values):
    present, scale = vehicle.attitude_time_constant, values.get("scale", 1.0)
    if scale == 1.0:
        return vehicle
    return vehicle.changed(attitude_time_constant=max(present * scale, min(present, _LEAST_TIME)))


def _second_order(vehicle, values):
    present, lag = 1.0 / vehicle.attitude_bandwidth, values.get("rate_lag", 0.0)
    if lag == 0.0:
        return vehicle
    new, tau = max(present + lag, min(present, _QUICKEST)), vehicle.attitude_time_constant
    damping = vehicle.attitude_damping * (tau + present) / (tau + new)
    return vehicle.changed(attitude_bandwidth=1.0 / new, attitude_damping=damping)


def _level(vehicle, values):
    tilt = [values.get(name, 0.0) for name in ("roll", "pitch")]
    shown = (old + new for old, new in zip(vehicle.effects_mocap_tilt, tilt))
    trim = (old - new / vehicle.attitude_gain for old, new in zip(vehicle.effects_attitude_trim, tilt))
    return vehicle.changed(effects_mocap_tilt=tuple(shown), effects_attitude_trim=tuple(trim))


def _angles(plausible: float, name: str) -> tuple[Parameter, ...]:
    """Return the parameters of roll and pitch; name: that of the constant reported for an axis, or ""."""
    return tuple(
        Parameter(
            axis,
            unit="rad",
            bounds=(-0.25, 0.25),
            plausible=sign * plausible,
            negligible=0.0035,
            reported=name.format(axis),
        )
        for axis, sign in (("roll", 1.0), ("pitch", -1.0))
    )


EFFECTS = (
    Effect(
        name="attitude_gain",
        description="The steady roll and pitch angles are larger or smaller than modelled for a given "
        "command.",
        formula="d(angle)/dt = (scale gain command - angle)/time_constant",
        source="Kooi and Babuska 2021: k identified in flight; about 0.89 in the utias_fmpc flights",
        parameters=(
            Parameter(
                "scale",
                neutral=1.0,
                bounds=(0.4, 1.8),
                plausible=0.85,
                negligible=0.02,
                fields=("attitude_gain",),
                reported="attitude gain k",
            ),
        ),
        regimes=("attitude_step", "lateral"),
        confused_with=("attitude_time_constant", "attitude_trim"),
        remedy="Check units and signs of the commands, then calibrate: multiply the commands by 1/scale.",
        channels=("attitude",),
        says="the steady tilt is {scale} times the modelled one",
    ),
    Effect(
        name="attitude_time_constant",
        description="The roll and pitch loops are slower or faster than modelled: different controller gains "
        "in the firmware, a different inertia.",
        formula="d(angle)/dt = (gain command - angle)/(scale time_constant), at least 8.1 ms",
        source="Kooi and Babuska 2021: tau = 0.184 s; about 0.06 s in the utias_fmpc flights",
        parameters=(
            Parameter(
                "scale",
                neutral=1.0,
                bounds=(0.06, 4.0),
                plausible=0.6,
                negligible=0.08,
                fields=("attitude_time_constant",),
                reported="attitude time constant tau",
            ),
        ),
        regimes=("attitude_step", "lateral"),
        confused_with=("second_order_attitude", "attitude_delay", "attitude_gain"),
        remedy="Use the attitude controller gains the model was identified with, or accept the new constant.",
        channels=("attitude",),
        apply=_time_constant,
        is_lag=True,
        says="the attitude loops have {scale} times the modelled time constant",
    ),
    Effect(
        name="second_order_attitude",
        description="The rate loop under the attitude loop is slower than modelled: the angles start later "
        "and overshoot more, but have the same mean delay. A negative lag is a faster loop.",
        formula="1/bandwidth + rate_lag, at least 2 ms in total, instead of 1/bandwidth in "
        "d2(angle)/dt2 = bandwidth (wanted rate - rate); the term with the rate is unchanged",
        source="cascaded attitude and rate controllers of the Crazyflie firmware",
        parameters=(
            Parameter(
                "rate_lag",
                unit="s",
                bounds=(-0.017, 0.15),
                plausible=0.03,
                negligible=0.008,
                fields=("attitude_bandwidth",),
                inverse=True,
                reported="rate loop lag",
            ),
        ),
        regimes=("attitude_step",),
        confused_with=("attitude_delay", "attitude_time_constant"),
        remedy="Raise the rate controller's gains, or check for slack in motor mounts and heavy propellers.",
        channels=("attitude",),
        apply=_second_order,
        is_lag=True,
        says="the rate loop lags by {rate_lag} more than modelled",
    ),
    Effect(
        name="attitude_integral",
        description="The roll and pitch loops integrate the angle error: a step overshoots and comes back "
        "slowly, and a steady moment leaves no steady tilt.",
        formula="d(angle)/dt = (error + rate integral(error))/time_constant, error = gain command - angle; "
        "|integral| up to attitude.integral_limit",
        source="the Crazyflie firmware's PID of roll and pitch: ki/kp = 3/6 1/s, of the rates 500/250 1/s",
        parameters=(
            Parameter(
                "rate",
                unit="rad/(rad s)",
                bounds=(-0.2, 5.0),
                plausible=0.5,
                negligible=0.05,
                one_signed=True,
                reported="attitude integral ki/kp",
            ),
        ),
        regimes=("attitude_step", "lateral"),
        confused_with=("attitude_gain", "attitude_trim", "com_offset"),
        remedy="Use the integral gains of the attitude and rate controllers that the model was identified "
        "with, or accept the new constant.",
        channels=("attitude",),
        identified=False,
        says="the integral gain of the attitude loops is {rate} higher than modelled",
    ),
    Effect(
        name="attitude_saturation",
        description="The roll and pitch loops limit the angular rate: large steps of the command are "
        "followed at that rate, small ones as modelled.",
        formula="|d(angle)/dt that is wanted| up to 1/(saturation + inverse)",
        source="rate limits of flight controllers; saturated motors act the same way",
        parameters=(
            Parameter(
                "inverse",
                unit="s/rad",
                bounds=(0.0, 4.0),
                plausible=0.4,
                negligible=0.08,
                one_signed=True,
                reported="attitude rate saturation, inverse",
            ),
        ),
        regimes=("attitude_step",),
        confused_with=("attitude_time_constant", "second_order_attitude", "attitude_delay"),
        remedy="Raise the controller's rate limit, or command smaller steps; a small and a large step "
        "distinguish it from a slow loop.",
        channels=("attitude",),
        is_lag=True,
        identified=False,
        says="the attitude loops limit the angular rate; the inverse of the limit is {inverse}",
    ),
    Effect(
        name="attitude_trim",
        description="Level flight is commanded, but the vehicle holds a small constant tilt in its own "
        "frame: a tilted sensor, an uncalibrated accelerometer, or motion capture markers out of level.",
        formula="roll and pitch command + (roll, pitch)",
        source="the Crazyflie client's trim fields; -0.05 and -0.02 rad in the utias_fmpc flights",
        parameters=_angles(0.02, "{} trim"),
        regimes=("hover", "attitude_step", "lateral"),
        confused_with=("wind", "com_offset"),
        remedy="Calibrate the accelerometer on a level table, redefine the rigid body in the motion capture "
        "system, or enter the trim in the Crazyflie client.",
        channels=("attitude",),
        says="under level commands the vehicle holds {roll} of roll and {pitch} of pitch",
    ),
    Effect(
        name="mocap_tilt",
        description="The measured attitude is tilted relative to the rotors: the rigid body of the motion "
        "capture, or the onboard estimate, was levelled on a vehicle that was not level. The flight itself "
        "is unchanged, but the thrust appears to point elsewhere.",
        formula="measured R = R Rx(roll) Ry(pitch)",
        source="the utias_fmpc flights hover with 0.05 rad of measured roll",
        parameters=_angles(0.03, "measured {}, tilt"),
        regimes=("hover", "lateral", "climb"),
        confused_with=("wind", "attitude_trim"),
        remedy="Redefine the rigid body with the vehicle on a level table, or turn the measured attitude "
        "back. To distinguish it from wind, hover while the vehicle yaws: a tilt turns with it, wind does "
        "not.",
        channels=("translation", "attitude"),
        says="the measured attitude is tilted relative to the rotors by {roll} of roll and {pitch} of pitch",
    ),
    Effect(
        name="level_calibration",
        description="The attitude estimate that the onboard control and the log share is tilted: the "
        "sensors were levelled on a vehicle that was not level. The logged attitude follows the commands, "
        "but the rotors point elsewhere.",
        formula="measured R = R Rx(roll) Ry(pitch), command - (roll, pitch)/gain: to first order "
        "the loops hold the measured angles",
        source="accelerometer of the Crazyflie: levelled at start-up to about 1 deg",
        parameters=_angles(0.02, ""),
        regimes=("hover", "lateral", "climb"),
        confused_with=("wind", "mocap_tilt", "attitude_trim"),
        remedy="Calibrate the accelerometer on a level table. To distinguish it from wind, hover while the "
        "vehicle "
        "yaws: a tilt turns with it, wind does not. The logged angles match the commands here, and not with "
        "a tilt of the motion capture or a trim alone.",
        channels=("translation", "attitude"),
        apply=_level,
        says="the attitude estimate of control and log is tilted by {roll} of roll and {pitch} of pitch",
    ),
    Effect(
        name="estimator_lean",
        description="The onboard estimate ignores drag: it interprets the deceleration as less tilt, and "
        "the control, which holds the estimate, lets the vehicle lean into its motion. Drag appears smaller "
        "than it is.",
        formula="roll and pitch held by the loops: roll + lean v_left, pitch - lean v_forward",
        source="nanobench: estimated less measured pitch -0.021 v_forward, roll +0.024 v_left; at most "
        "drag/(mass g), 0.04 rad s/m there",
        parameters=(Parameter("lean", unit="rad s/m", bounds=(-0.1, 0.1), plausible=0.02, negligible=0.004),),
        regimes=("lateral",),
        confused_with=("rotor_drag", "attitude_gain", "body_drag"),
        remedy="Log the onboard estimate and the motion capture: their difference grows with the speed. "
        "Trust the orientation of the motion capture more in the estimator, or give it a drag term.",
        channels=("attitude",),
        says="the vehicle leans into its motion by {lean} more than its own estimate shows",
    ),
    Effect(
        name="yaw_loop",
        description="The gain or the time constant of the yaw rate differs from the model: gains of the "
        "firmware's rate controller, another inertia, weak yaw authority.",
        formula="d(yaw rate)/dt = bandwidth/time_constant (gain yaw_gain command + drift - yaw rate)",
        source="the firmware's yaw rate controller; yaw is driven by the rotors' reaction torque only",
        parameters=(
            Parameter(
                "gain",
                neutral=1.0,
                bounds=(0.3, 2.0),
                plausible=0.9,
                negligible=0.01,
                fields=("attitude_yaw_gain",),
                reported="yaw rate gain",
            ),
            Parameter(
                "time_constant",
                neutral=1.0,
                bounds=(0.1, 8.0),
                plausible=1.5,
                negligible=0.1,
                fields=("attitude_yaw_bandwidth",),
                inverse=True,
                reported="yaw rate time constant",
            ),
        ),
        regimes=("lateral", "hover"),
        confused_with=("yaw_drift", "attitude_delay"),
        remedy="Use the yaw controller gains the model was identified with, or accept the new constants. A "
        "drift is visible while no yaw rate is commanded, a gain is not.",
        channels=("yaw",),
        is_lag=True,
        says="the yaw rate is {gain} times the modelled one, its time constant {time_constant} times",
        # Commands that only hold the heading answer to what disturbs it: 0.3 rad/s turn it by more.
        requires={"yaw_rate_command": 0.3},
    ),
    Effect(
        name="yaw_drift",
        description="The heading turns slowly although no yaw rate is commanded: a gyroscope bias.",
        formula="d(yaw)/dt = yaw rate command + rate",
        source="bias of consumer gyroscopes",
        parameters=(Parameter("rate", unit="rad/s", bounds=(-1.0, 1.0), plausible=0.05, negligible=0.003),),
        regimes=("hover", "climb", "lateral", "attitude_step"),
        confused_with=("yaw_loop",),
        remedy="Keep the vehicle still while it starts, so that the gyroscopes calibrate.",
        channels=("yaw",),
        says="the heading turns by {rate} without a command",
    ),
)
