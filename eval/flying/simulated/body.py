"""The vehicle itself: the MuJoCo plant in steps of 4 ms.

Axes here are the project's: body x forward, y left, z up, R = Rz(yaw) Rx(roll) Ry(pitch), positive pitch
leans towards +x. The firmware uses others, which only `firmware_attitude` and `plant_command` convert:

- its angles are those of Rz(yaw) Ry(pitch) Rx(roll);
- its pitch is inverted, in set-points and in logs ("legacy CF2 body coordinate system", `kalman_core.c`,
  `estimator_complementary.c`); cflib's `Commander.send_setpoint` inverts what it is given once more.
"""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.eval.flying.simulated.firmware import FirmwareSetpoint
from inclined_landing.models import attitude_loops, forces
from inclined_landing.models.attitude import LAG, ROLL, VX, YAW, quaternion, rotation, tilted
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import apply
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plausible import ENGINE_STEP
from inclined_landing.models.vehicle import Vehicle

FLOOR = 2  # index of the floor in geometry.SURFACES
_SETTLING = 1e-4  # m by which the feet are set into the floor
# Gaps of the hidden vehicle, unknown to every policy: the thrust of the paper's flights, an attitude
# estimate levelled on a table that was not, and what a radio and firmware queues add in delay.
HIDDEN = {
    "thrust_scale": {"scale": 0.88},
    "level_calibration": {"roll": math.radians(0.6), "pitch": math.radians(-1.0)},
    "thrust_delay": {"delay": 0.015},
    "attitude_delay": {"delay": 0.015},
}


class Body:
    """One simulated vehicle next to the platform, initially on the floor with its motors off.

    start: x, y [m] on the floor; heading [rad]; inclination of the platform [rad], None for the vehicle
    file's, and whether it is present; seed of the disturbance of the air. Raises UserError for a start
    outside the arena or under the platform.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        start: tuple[float, float],
        heading: float = 0.0,
        inclination: float | None = None,
        platform: bool = True,
        seed: int = 0,
    ):
        self.vehicle = vehicle
        self._constants = forces.pack(vehicle)[0]
        self.step_length = ENGINE_STEP
        self.time = 0.0
        restless = any((*vehicle.disturbance_acceleration, *vehicle.disturbance_angular))
        self.plant = MujocoPlant(
            *(1, vehicle),
            control_period=ENGINE_STEP,
            torque_needs_motors=True,
            disturbance=seed if restless else None,
            threads=1,
        )
        angle = vehicle.platform_inclination if inclination is None else inclination
        if inclination is not None or not platform:
            self.plant.set_platform([0], vehicle.check_inclination(angle), platform)
        _check_start(start, vehicle)
        state = np.zeros((1, 13))
        state[0, :2], state[0, 2], state[0, YAW] = start, self.plant.foot_height - _SETTLING, heading
        self.plant.reset([0], state)
        self._command = np.zeros((1, 4))
        self.command = self._command[0]  # of the last step: PWM, roll, pitch [rad], yaw rate [rad/s]
        self.state = self._before = self.plant.state[0].copy()  # (13,) at `time`
        self._shown = self.plant.measurement[0].copy()
        self._shown_before = self._shown
        # (3,) g: all forces but gravity in the body frame, mean over the last step; 1 up at rest, 0 in a fall
        self.specific_force = np.array([0.0, 0.0, 1.0])
        self.voltage_drop = 0.0  # V by which the battery is emptier than the vehicle file says

    @property
    def touching(self) -> np.ndarray:
        """Whether slab, base and floor were in contact in the last step, (3,) bool."""
        return self.plant.contacts.touch[0].any(axis=1)

    def step(self, setpoint: FirmwareSetpoint) -> None:
        """Advance by one engine step under the firmware's set-point."""
        self._command[0] = plant_command(setpoint)
        self.plant.step(self._command)
        self.time += self.step_length
        self._before, self.state = self.state, self.plant.state[0].copy()
        self._shown_before, self._shown = self._shown, self.plant.measurement[0].copy()
        # f = R' (dv/dt + g e_z) / g, in the body frame
        change = (self.state[VX : VX + 3] - self._before[VX : VX + 3]) / self.step_length
        change[2] += self.vehicle.environment_gravity
        self.specific_force = (
            rotation(*self.state[ROLL : YAW + 1]).T @ change / self.vehicle.environment_gravity
        )

    def state_at(self, time: float) -> np.ndarray:
        """Return the state (13,) at a time within the last step."""
        return _between(self._before, self.state, (time - self.time) / self.step_length + 1.0)

    def pose_at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return position (3,) [m] and quaternion (4,) that cameras see at a time within the last step."""
        seen = _between(self._shown_before, self._shown, (time - self.time) / self.step_length + 1.0)
        return seen[:3], np.array(quaternion(*seen[ROLL : YAW + 1]))

    def estimate_at(self, time: float) -> np.ndarray:
        """Return roll, pitch, yaw (3,) [rad] of the onboard estimate, with the vehicle file's errors."""
        state = self.state_at(time)
        angles = state[ROLL : YAW + 1].copy()
        angles[:2] = attitude_loops.estimated_angles(*angles, *state[VX : VX + 3], self._constants)
        turned = angles[None].copy()
        tilted(angles[None], *self.vehicle.effects_mocap_tilt, turned)
        return turned[0]

    @property
    def voltage(self) -> float:
        """Battery voltage under the present load [V]."""
        return forces.battery_voltage(self.state[LAG], self.time, self._constants) - self.voltage_drop


def named_vehicle(name: str) -> Vehicle:
    """Return the vehicle "nominal", "hidden" (HIDDEN applied to the nominal one), or that of a vehicle file.

    Raises UserError for a file that cannot be read.
    """
    if name == "nominal":
        return load_vehicle()
    return apply(load_vehicle(), HIDDEN) if name == "hidden" else load_vehicle(name)


def firmware_attitude(roll: float, pitch: float, yaw: float) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [deg] as the firmware logs them, from the project's angles [rad]."""
    r = rotation(roll, pitch, yaw)
    forward = math.asin(min(1.0, max(-1.0, -r[2, 0])))
    return (
        math.degrees(math.atan2(r[2, 1], r[2, 2])),
        -math.degrees(forward),
        math.degrees(math.atan2(r[1, 0], r[0, 0])),
    )


def plant_command(setpoint: FirmwareSetpoint) -> tuple[float, float, float, float]:
    """Return PWM, roll, pitch [rad], yaw rate [rad/s] of the plant for a set-point of the firmware.

    The rotors' axis is the same in both conventions: (sin p cos r, -sin r, cos p cos r) for the firmware's r
    and p.
    """
    r, p = math.radians(setpoint.roll), -math.radians(setpoint.pitch)
    x, y, z = math.sin(p) * math.cos(r), -math.sin(r), math.cos(p) * math.cos(r)
    return setpoint.thrust, math.atan2(-y, z), math.asin(x), math.radians(setpoint.yaw_rate)


def _between(before: np.ndarray, after: np.ndarray, share: float) -> np.ndarray:
    """Return the state interpolated linearly at a share of the step, angles along the shorter way."""
    change = after - before
    change[ROLL : YAW + 1] = (change[ROLL : YAW + 1] + math.pi) % (2 * math.pi) - math.pi
    return before + share * change


def _check_start(start: tuple[float, float], v: Vehicle) -> None:
    (x, y), room = start, 0.1
    if not (all(map(math.isfinite, start)) and abs(x) < 1e3 and abs(y) < 1e3):
        raise UserError(f"the start on the floor must be X,Y in metres, not {x},{y}")
    if not (v.arena_x[0] < x < v.arena_x[1] and v.arena_y[0] < y < v.arena_y[1]):
        raise UserError(f"the start {x:g},{y:g} on the floor lies outside the arena")
    if abs(x) < v.slab_half_length + room and abs(y) < v.platform_depth / 2 + room:
        raise UserError(f"the start {x:g},{y:g} on the floor lies under the platform")
