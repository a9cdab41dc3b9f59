"""The pilot: one flight from the floor to the slope, or along a planned flight.

Phases: the set-point policy takes off and flies to the start (approach); after it has been near it and slow
for some time, the landing policy flies the vehicle (landing) into the goal box, where the motors are cut, or
until it rests on the slope with motors stopped by the policy (touchdown). Alternatively a planned flight is
tracked (plan), after which the set-point policy sets the vehicle down (retreat). Every cause in `safety` ends
the flight by its reaction: motors off, or the set-point policy sets the vehicle down next to the platform
(retreat).

The pilot holds the heading at 0 unless a plan turns. In the landing, which is planar, it also holds y at 0
with the set-point policy's roll.
"""

from __future__ import annotations

import contextlib
import math
import traceback
from collections.abc import Callable

import numpy as np

from inclined_landing.envs.hover import HAND_OVER_SPEED, HAND_OVER_TIME, TOLERANCE, YAW_GAIN
from inclined_landing.envs.tasks.touchdown import REST_SPEED
from inclined_landing.eval.flying import frames, safety
from inclined_landing.eval.flying.estimate import (
    POSITION_NOISE,
    Attitude,
    ConsistencyMonitor,
    Estimator,
    RestMonitor,
    StateEstimate,
)
from inclined_landing.eval.flying.flight_log import FlightLogWriter
from inclined_landing.eval.flying.interfaces import FlightClock, MeasuredPose, MotionCapture
from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.policies import InvalidAction, SetpointFollower
from inclined_landing.eval.flying.positions import NOISE, OnboardPosition
from inclined_landing.eval.flying.preflight import RECORDING_TIME, Check, preflight_checks
from inclined_landing.eval.flying.report import FlightReport
from inclined_landing.eval.flying.safety import Cause, FlightStatus, Phase, Reaction
from inclined_landing.eval.flying.surroundings import IMPACT_DISTANCE, MovingTarget
from inclined_landing.eval.flying.vehicle import Radio, Status
from inclined_landing.eval.flying.watchdog import Watchdog, interruptible, uninterruptible
from inclined_landing.models.attitude import PITCH_COMMAND, PWM, ROLL_COMMAND, VX, VZ, YAW, X, Z
from inclined_landing.models.attitude import YAW_RATE_COMMAND as YAW_RATE
from inclined_landing.models.base.errors import UserError

TICKS = 4  # looks at the motion capture per control period: 200 Hz sees every pose of a system of 120 Hz
APPROACH_SPEED, RETREAT_SPEED = 0.6, 0.4  # m/s, of the point that the set-point policy follows
LIFT_OFF = 0.05  # m above where it stood
UPRIGHT = math.radians(20.0)  # between the tilt of a vehicle on its feet and the platform's inclination
STUCK_TIME = 0.5  # s without sinking at the end of a retreat: it stands
AFTER_FLIGHT_TIME = 2.5  # s of stop commands after the flight, until the supervisor calls the vehicle landed
DRY_RUN, DRY_RUN_PERIOD = 30.0, 0.5  # s: how long it is, and how often it prints


class Pilot:
    """The pilot of one connected vehicle; a new one for every flight.

    say: called with every line of output. hang_limit [s]: see `Watchdog`. guarded: returns whether the
    process that stops the motors if this one dies is running.
    """

    def __init__(
        self,
        radio: Radio,
        clock: FlightClock,
        mocap: MotionCapture,
        plan: FlightPlan,
        *,
        say: Callable[[str], None] = print,
        hang_limit: float = safety.HANG_LIMIT,
        guarded: Callable[[], bool] = lambda: True,
    ):
        self.radio, self.clock, self.mocap, self.plan = radio, clock, mocap, plan
        self.surroundings, self.vehicle = plan.surroundings, plan.surroundings.vehicle
        self.phase = Phase.APPROACH
        self.report = FlightReport("")
        self.home: np.ndarray | None = None
        self._print, self._hang_limit, self._guarded = say, hang_limit, guarded
        self._log: FlightLogWriter | None = None
        onboard = isinstance(mocap, OnboardPosition)
        noise, heading = (NOISE, None) if onboard else (POSITION_NOISE, plan.heading)
        self._estimator = Estimator(self.vehicle, noise, heading)
        self._monitor = safety.SafetyMonitor(self.vehicle)
        self._consistency = ConsistencyMonitor(self.vehicle.environment_gravity)
        self._follower = SetpointFollower(plan.setpoint)
        self._final = plan.final
        self._period = self.vehicle.command_control_period
        self._rest = RestMonitor(self._period)
        self._status = Status(-math.inf, math.nan, False)
        self._target: MovingTarget | None = None
        self._began = self._phase_began = 0.0
        self._airborne = False
        self._steps_at_start = 0  # control steps in a row
        self._stuck_time = 0.0
        self._announced: Cause | None = None
        self._last_print = -math.inf

    # --- before ----------------------------------------------------------------------------------

    def check(self) -> list[Check]:
        """Return the preflight checks, from a second of measurements, and set the vehicle's home."""
        end = self.clock.now() + RECORDING_TIME
        self._receive()
        poses, attitudes = list[MeasuredPose](), 0
        while self.clock.now() < end:
            self.clock.wait_until(self.clock.now() + self._period / TICKS)
            pose, count = self._receive()
            poses += [] if pose is None else [pose]
            attitudes += count
        estimate = self._estimator.predict(self.clock.now())
        onboard = isinstance(self.mocap, OnboardPosition)
        source = "onboard position (Lighthouse deck)" if onboard else "motion capture"
        measured = (source, poses, attitudes, self._status, estimate)
        found = preflight_checks(*measured, self.surroundings, self.plan.stand)
        if all(check.passed for check in found):
            self.home = np.mean([pose.position for pose in poses], axis=0)
            way = self.surroundings.path_to(self.home, self.plan.start_point)
            self._target = MovingTarget(self.home, way, APPROACH_SPEED)
        return found

    # --- the flight ------------------------------------------------------------------------------

    def fly(self, log: FlightLogWriter | None = None) -> FlightReport:
        """Fly, and return the report; whatever happens, the motors are off afterwards.

        log: begins with the flight; the caller has to finish it. `check` must have passed. Errors and
        interruptions are recorded in the report and not raised.
        """
        if self._target is None:
            raise ValueError("the checks must have passed before a flight")
        try:  # also compiles everything that is not compiled yet
            here = self._estimator.predict(self.clock.now()).state
            self._final.step(0.0, here, False)
            self._follower.roll_command_to_hold(here, 0.0)
        except InvalidAction:
            self._end(safety.BAD_ACTION)
            return self.report
        self._final.reset()
        self._follower.actor.reset()
        try:
            if log is not None:
                now = self.clock.now()
                log.begin(now)
                self._log = log
                self._log.voltage(now, self._status.voltage)  # the last ones before the log begins
                if self._estimator.attitude is not None:
                    self._log_attitude(self._estimator.attitude)
            with interruptible(), Watchdog(self._hang_limit, self.radio.emergency_stop) as watchdog:
                self._began = self._phase_began = self.clock.now()
                self.radio.arm()
                self._log_motors_off()
                self._loop(watchdog)
        except KeyboardInterrupt:
            self._end(safety.INTERRUPTED)
        except UserError as error:
            self._end(safety.ERROR)
            self.report.error = str(error)
        except Exception as error:
            self._end(safety.ERROR)
            self.report.error = "".join(traceback.format_exception(error)).strip()
        finally:
            with uninterruptible():
                self._motors_off()
        with contextlib.suppress(Exception):
            self._track_after_flight()
        return self.report

    def _loop(self, watchdog) -> None:
        """Run control steps at their period until the flight is over."""
        begin, k = self.clock.now(), 0
        while self.phase is not Phase.OVER:
            for tick in range(1, TICKS + 1):
                self.clock.wait_until(begin + (k + tick / TICKS) * self._period)
                self._receive()
                watchdog.feed()
            if watchdog.triggered:
                self._end(safety.HANG)
                return
            k += 1
            now = self.clock.now()
            late = max(0.0, now - (begin + k * self._period))
            if late > self._period:  # go on from here, send nothing twice
                begin = now - k * self._period
            self._step(now, late)
            if self.radio.dry and self.phase is not Phase.OVER and now - self._began > DRY_RUN:
                self._end(None, "dry run")

    def _step(self, time: float, late: float) -> None:
        """Run one control step, `late` [s] after its time: safety checks, then a command."""
        if not (self.report.unguarded or self._guarded()):
            self.report.unguarded = True
            self._print("the watchdog process, which would stop the motors should this one die, is gone")
        estimate = self._estimator.predict(time)
        cause = self._monitor.cause(self._flight_status(estimate, late))
        if cause is not None:
            self._react(cause, estimate)
        if self.phase is Phase.OVER:
            return
        try:
            command = self._command(estimate)
        except InvalidAction as bad:
            landing = bad.policy is self._final.policy
            self._react(safety.BAD_ACTION if landing else safety.BAD_SETPOINT, estimate)
            if self.phase is Phase.OVER:
                return
            command = self._command(estimate)
        if command is None:
            return
        if not self._turns:
            heading, limit = estimate.state[YAW], self.vehicle.command_yaw_rate_limit
            command[YAW_RATE] = min(limit, max(-limit, -YAW_GAIN * heading))
            command = frames.in_heading(command, heading)
        self.radio.send(command)
        if self._log is not None:
            self._log.command(time, command)
        if self.radio.dry:
            self._print_dry_run(time, estimate, command)

    @property
    def _turns(self) -> bool:
        """Whether the commands of this phase are in the vehicle's heading, with a yaw rate of their own."""
        return self._final.turns and self.phase is self._final.phase

    def _flight_status(self, estimate: StateEstimate, late: float = 0.0) -> FlightStatus:
        """Return what the safety monitor checks in this control step."""
        time, state = estimate.time, estimate.state
        if self.home is not None and state[2] > self.home[2] + LIFT_OFF:
            self._airborne = True
        contact = self.surroundings.in_contact(state)
        self._rest.update(state[X : Z + 1], self._airborne and contact)
        self._check_consistency(estimate, contact)
        since, yaw = time - self._phase_began, float(state[YAW])
        return FlightStatus(
            phase=self.phase,
            since=since,
            estimate=estimate,
            airborne=self._airborne,
            linked=self.radio.lost is None,
            locked=self._status.locked,
            voltage=self._status.voltage,
            heading_error=self._final.heading_error(since, yaw) if self._turns else yaw,
            velocity_mismatch=self._consistency.velocity_mismatch,
            resting_time=self._rest.time,
            landing_limit=self._final.limit,
            astray=self._final.astray,
            near=self.surroundings.is_near(state, IMPACT_DISTANCE),
            late=late,
        )

    def _check_consistency(self, estimate: StateEstimate, contact: bool) -> None:
        """Compare motion with forces while the vehicle touches nothing."""
        attitude = self._estimator.attitude
        rotation = None if attitude is None else self._estimator.to_arena(attitude)
        if not self._airborne or rotation is None or contact:
            self._consistency.reset()
        elif attitude is not None:
            velocity = estimate.state[VX : VZ + 1]
            self._consistency.update(estimate.time, velocity, rotation[:, 2], attitude.specific_force)

    def _command(self, estimate: StateEstimate) -> np.ndarray | None:
        """Return the command (4,) of the present phase, which may end here; None when the flight is over."""
        state = estimate.state
        if self.phase is Phase.APPROACH:
            command = self._approach(state)
            if self._steps_at_start * self._period < HAND_OVER_TIME:
                return command
            self._enter(self._final.phase)
            self.report.start = state.copy()
            self._print(f"hand-over at x {state[X]:.2f}, z {state[Z]:.2f} m")
        if self.phase is self._final.phase:
            return self._fly_final(estimate)
        return self._retreat(state)

    def _approach(self, state: np.ndarray) -> np.ndarray:
        """Return the command (4,) towards the start; count control steps near it and slow."""
        assert self._target is not None
        target = self._target.advance(self._period, state[X : Z + 1])
        distance = float(np.linalg.norm(target - state[X : Z + 1]))
        slow = float(np.linalg.norm(state[VX : VZ + 1])) < HAND_OVER_SPEED
        self._steps_at_start = (
            self._steps_at_start + 1 if self._target.arrived and slow and distance < TOLERANCE else 0
        )
        return self._follower.command_towards(state, target, self._period)

    def _fly_final(self, estimate: StateEstimate) -> np.ndarray | None:
        """Return the command (4,) of the landing or the planned flight; None once it has landed."""
        state = estimate.state
        step = self._final.step(estimate.time - self._phase_began, state, self._rest.time > 0.0)
        if isinstance(step, str):
            if self.phase is Phase.LANDING:
                self.report.goal = state.copy()
                self.report.landing_time = estimate.time - self._phase_began
                self._end(None, step)
                return None
            self._print(f"{step}; setting the vehicle down")
            self._set_down(estimate)
            return self._retreat(state)
        if self._final.is_planar:
            step[ROLL_COMMAND] = self._follower.roll_command_to_hold(state, 0.0)
        if self.phase is Phase.PLAN:
            self.report.astray = max(self.report.astray or 0.0, self._final.astray)
        return step

    def _retreat(self, state: np.ndarray) -> np.ndarray | None:
        """Return the command (4,) that sets the vehicle down next to the platform; None once it is down."""
        assert self._target is not None
        command = self._follower.command_towards(
            state, self._target.advance(self._period, state[X : Z + 1]), self._period
        )
        below = state[Z] - self._target.position[2] > 0.1
        self._stuck_time = self._stuck_time + self._period if below and abs(state[VZ]) < REST_SPEED else 0.0
        down = (
            state[Z] < self.surroundings.standing_height + 2 * LIFT_OFF
            and self._target.position[2] < state[Z]
        )
        if down or self._stuck_time > STUCK_TIME:
            self._end(self.report.retreat, "" if self.report.retreat else "plan flown")
            return None
        return command

    # --- what happens to the flight ----------------------------------------------------------------

    def _react(self, cause: Cause, estimate: StateEstimate) -> None:
        """React to a cause: motors off, or retreat."""
        if self.radio.dry:
            if cause != self._announced:
                self._print(f"would react: {cause.name} ({cause.when}): {cause.reaction.value}")
            self._announced = cause
            return
        if cause.reaction is Reaction.OFF or not self._airborne:
            self._end(cause)
            return
        self._print(f"{cause.name}: {cause.when}; {cause.reaction.value}")
        self.report.retreat = cause
        self._set_down(estimate)

    def _set_down(self, estimate: StateEstimate) -> None:
        """Begin the way to a free place and down."""
        here = estimate.state[X : Z + 1].copy()
        self._target = MovingTarget(here, self.surroundings.path_down(here), RETREAT_SPEED)
        self._enter(Phase.RETREAT)

    def _enter(self, phase: Phase) -> None:
        self.phase, self._phase_began = phase, self.clock.now()
        self._stuck_time = 0.0
        self._final.reset()
        self._follower.actor.reset()

    def _end(self, cause: Cause | None, outcome: str = "") -> None:
        if self.phase is not Phase.OVER:
            self.phase = Phase.OVER
            self.report.cause = cause
            self.report.outcome = outcome or (cause.name if cause else "")

    def _motors_off(self) -> None:
        """Stop the motors; failures are ignored, so that nothing keeps the motors on."""
        cause = self.report.cause
        peaceful = self.phase is Phase.OVER and (cause is None or cause.reaction is Reaction.LAND)
        if peaceful:
            try:
                self.radio.stop()
            except Exception:
                peaceful = False
        if not peaceful:
            self.radio.emergency_stop()
        with contextlib.suppress(Exception):
            self._log_motors_off()

    def _log_attitude(self, attitude: Attitude) -> None:
        seen = self._estimator.to_arena(attitude)
        if self._log is not None and seen is not None:
            self._log.attitude(attitude.time, *frames.project_angles(seen))

    def _log_motors_off(self) -> None:
        if self._log is not None:
            self._log.command(self.clock.now(), np.zeros(4))

    def _track_after_flight(self) -> None:
        """Keep sending stop commands, and log where the vehicle comes to rest."""
        end = self.clock.now() + AFTER_FLIGHT_TIME
        while (now := self.clock.now()) < end:
            for _ in range(TICKS):
                with contextlib.suppress(Exception):
                    self.radio.stop()
                self.clock.wait_until(self.clock.now() + self._period / TICKS)
                self._receive()
            self._flight_status(self._estimator.predict(now + self._period))
        estimate = self._estimator.predict(self.clock.now())
        if estimate.pose_age < safety.POSE_LIMIT:
            self.report.final = estimate.state[X : Z + 1].copy()
            platform = self.surroundings.distances(estimate.state[None])[0, 0]
            leaning = abs(estimate.tilt - abs(self.surroundings.inclination))
            upright = not leaning > UPRIGHT  # NaN: no attitude
            self.report.rests = bool(self._rest.time > 0.0 and platform < 2 * LIFT_OFF and upright)

    # --- what is heard -----------------------------------------------------------------------------

    def _receive(self) -> tuple[MeasuredPose | None, int]:
        """Pass new data to estimator and log; return the new pose, if any, and the number of attitudes."""
        pose, attitudes, last = self.mocap.latest(), 0, self._estimator.last_pose
        if pose is not None and last is not None and pose.time <= last.time:
            pose = None
        if pose is not None:
            near = self.surroundings.is_near(self._estimator.predict(pose.time).state, IMPACT_DISTANCE)
            contact_updates = self._estimator.filter.contact_updates
            self._estimator.add_pose(pose, impact=near)
            if self.phase is Phase.LANDING:
                self.report.touched |= self._estimator.filter.contact_updates > contact_updates
            if self._log is not None:
                state = self._estimator.predict(pose.time).state
                self._log.pose(pose.time, pose.position, self.surroundings.in_contact(state))
        for received in self.radio.received():
            if isinstance(received, Attitude):
                attitudes += 1
                self._estimator.add_attitude(received)
                self._log_attitude(received)
            else:
                self._status = received
                if self._log is not None:
                    self._log.voltage(received.time, received.voltage)
        return pose, attitudes

    def _print_dry_run(self, time: float, estimate: StateEstimate, command: np.ndarray) -> None:
        if time - self._last_print < DRY_RUN_PERIOD:
            return
        self._last_print = time
        x, y, z = estimate.state[X : Z + 1]
        self._print(
            f"{time - self._began:5.1f} s  {self.phase.value:8}  x {x:z6.2f}  y {y:z6.2f}  z {z:5.2f} m  "
            f"would command PWM {command[PWM]:5.0f}, roll {math.degrees(command[ROLL_COMMAND]):z5.1f}, "
            f"pitch {math.degrees(command[PITCH_COMMAND]):z5.1f} deg, "
            f"yaw rate {math.degrees(command[YAW_RATE]):z6.1f} deg/s"
        )
