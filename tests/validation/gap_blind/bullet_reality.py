"""Landings on Bullet's contact: rigid feet with restitution and a friction cone, solved by impulses.

Vehicle, pilot and air are those of the simulator's reference. From shortly above the surface on, its body is
one of Bullet under the same forces: four spheres below the motors over a slab, or over the floor. The
`damping_scale` of its world is a power of the restitution; a `stiffness_scale` below 1 puts springs under the
feet.

Bullet is a package of its own (zlib license): pip install 'inclined-landing[baselines]'.
"""

from __future__ import annotations

import math

import numpy as np
import pybullet as bullet
from scipy.spatial.transform import Rotation

from tests.validation.simulator import Constants, Reality, Recording, World, control, dynamics, reference
from tests.validation.simulator.flight import initial_state
from tests.validation.simulator.vehicle import CONTROL_RATE, PHYSICS_RATE, PILOT_RATE, TRACK_RATE, record

_RESTITUTION, _SLOWEST = 0.1, 0.05  # of touches above so many m/s
_SPRING = 120.0, 1.3  # N/m, N s/m, of one foot with a `stiffness_scale` just below 1
_FOOT, _SLAB = 0.002, (0.444, 0.25, 0.01)  # m: radius of the spheres, half sizes
_WARM_UP, _AFTER = 1.0, 0.8  # s flown before the log begins, and after the touch
_NEAR = 0.03  # m, of a foot above the surface, where Bullet takes over
_STEP, _PERIOD = 1.0 / PHYSICS_RATE, 1.0 / CONTROL_RATE


def fly(
    path: np.ndarray, world: World, rng: np.random.Generator, reality: Reality | None = None
) -> Recording:
    """Fly one path (k, REF_SIZE) down to the surface; see `simulator.fly`."""
    reality = reference() if reality is None else reality
    c, b = reality.constants, reality.build
    path = np.vstack([np.repeat(path[:1], round(_WARM_UP * PILOT_RATE), axis=0), path])
    per_pilot, per_track, per_log = (
        CONTROL_RATE // rate for rate in (PILOT_RATE, TRACK_RATE, reality.log_rate)
    )
    ticks = len(path) * per_pilot
    noise = np.array([c.position_noise] * 3 + [c.attitude_noise] * 3) * rng.standard_normal((ticks, 6))
    gyro_noise = c.gyro_noise * rng.standard_normal((ticks, 3))
    s, records = (
        initial_state(path[0, :3], 0.0, c, world),
        tuple(map(record, (c, b, world._replace(contact=0.0)))),
    )
    position, velocity, integral = s[:3].copy(), np.zeros(3), np.zeros(3)
    memory, target, command = np.zeros(control.MEMORY), s[dynamics.ROTORS : dynamics.LOAD].copy(), np.zeros(4)
    body, rows, last = _Body(c, world, records, s), [], math.inf
    for k in range(ticks):
        pose, gyro = body.pose(), s[dynamics.RATES : dynamics.ROTORS] + gyro_noise[k]
        if k % per_track == 0:
            position += velocity / TRACK_RATE
            error = pose[:3] + noise[k, :3] - position
            position += c.position_filter[0] * error
            velocity += c.position_filter[1] * TRACK_RATE * error
        if k % per_pilot == 0:
            control.pilot(path[k // per_pilot], position, velocity, pose[5], integral, records[0], command)
        control.flight_controller(
            *(command[0], command[1:], pose[3], pose[4], gyro, memory, 1.0 / CONTROL_RATE, *records, target)
        )
        touched = body.advance(target)
        last = min(last, k + _AFTER * CONTROL_RATE) if touched else last
        if k > last:
            break
        if k % per_log == 0:
            rates, thrust = (
                s[dynamics.RATES : dynamics.ROTORS],
                c.thrust_per_speed * s[dynamics.ROTORS : dynamics.LOAD] ** 2,
            )
            rows.append([*pose + noise[k], *command, touched, *pose[:3], *s[3:6], *pose[3:], *rates, *thrust])
    body.close()
    log = np.array(rows)[round(_WARM_UP * reality.log_rate) :]
    t, volts = np.arange(len(log)) / reality.log_rate, np.full(len(log), c.battery_voltage)
    return Recording(t, log[:, :3], log[:, 3:6], log[:, 6:10], volts, log[:, 10] > 0, log[:, 11:])


class _Body:
    """The vehicle and its state s (SIZE,): advanced by the simulator in the air, by Bullet near a surface."""

    def __init__(self, c: Constants, w: World, records: tuple, s: np.ndarray):
        self.c, self.w, self.records, self.s = c, w, records, s
        self.reach, self.client, self.id = c.foot_height + w.foot_height, {}, -1
        self.work, self.r, self.force = np.zeros((4, dynamics.SIZE)), np.zeros((3, 3)), np.zeros(4)
        self.anchor, self.air = np.full((4, 3), np.nan), np.zeros(8)
        # Bullet forgets the restitution of a box that is turned: its world is the surface's frame.
        turn = Rotation.from_euler("y", w.surface_tilt)
        self.frame, self.turn, self.at = turn.as_matrix(), turn.as_quat(), [0.0, 0.0, w.surface_height]

    def pose(self) -> np.ndarray:
        """Return position, roll, pitch and yaw (6,)."""
        dynamics.rotation(self.s[dynamics.QUATERNION : dynamics.RATES], self.r)
        return np.array([*self.s[:3], *dynamics.angles(self.r)])

    def advance(self, target: np.ndarray) -> bool:
        """Advance by a control period; returns whether a foot touched."""
        tilt = self.w.surface_tilt
        above = self.s[0] * math.sin(tilt) + (self.s[2] - self.w.surface_height) * math.cos(tilt)
        if not self.client and above < self.reach + _NEAR:
            self._enter()
        if self.client:
            return self._step(target)
        scratch = self.work, self.r, self.force
        dynamics.advance(self.s, target, self.air, self.anchor, 0.0, _PERIOD, *self.records, *scratch)
        return False

    def _enter(self) -> None:
        """Make the scene in Bullet, in the surface's frame, and the vehicle in its present state."""
        c, w, s = self.c, self.w, self.s
        self.client = {"physicsClientId": bullet.connect(bullet.DIRECT)}
        bullet.setGravity(*self.frame.T @ [0.0, 0.0, -c.gravity], **self.client)
        bullet.setTimeStep(_STEP, **self.client)
        bullet.setPhysicsEngineParameter(restitutionVelocityThreshold=_SLOWEST, **self.client)
        shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=_SLAB, **self.client)
        slab = bullet.createMultiBody(0.0, shape, -1, [0.0, 0.0, -_SLAB[2]], **self.client)
        bullet.changeDynamics(slab, -1, lateralFriction=1.0, restitution=1.0, **self.client)
        arm, low = c.arm * w.foot_spread, _FOOT - self.reach
        feet = [[arm * x, arm * y, low] for x, y in zip(dynamics.SIDE_X, dynamics.SIDE_Y)]
        shape = bullet.createCollisionShapeArray(
            shapeTypes=[bullet.GEOM_SPHERE] * 4,
            radii=[_FOOT] * 4,
            collisionFramePositions=feet,
            **self.client,
        )
        q = Rotation.from_matrix(self.frame.T @ self.r).as_quat()
        self.id = bullet.createMultiBody(
            c.mass, shape, -1, self.frame.T @ (s[:3] - self.at), q, **self.client
        )
        spring = {}
        if w.stiffness_scale < 1.0:
            spring = {"contactStiffness": _SPRING[0] * w.stiffness_scale, "contactDamping": _SPRING[1]}
        bullet.changeDynamics(
            *(self.id, -1),
            **{"localInertiaDiagonal": c.inertia, "linearDamping": 0.0, "angularDamping": 0.0},
            **{"lateralFriction": w.friction, "restitution": _RESTITUTION**w.damping_scale},
            **spring,
            **self.client,
        )
        turning = self.r @ s[dynamics.RATES : dynamics.ROTORS]
        bullet.resetBaseVelocity(self.id, self.frame.T @ s[3:6], self.frame.T @ turning, **self.client)

    def _step(self, target: np.ndarray) -> bool:
        """Advance by a control period of Bullet, other forces held; returns whether a foot touches."""
        c, s, change = self.c, self.s, np.zeros(dynamics.SIZE)
        dynamics.derivative(s, target, self.air, self.anchor, 0.0, *self.records, self.r, self.force, change)
        # Bullet has gravity and the gyroscopic torque itself.
        (p, q, o), (jx, jy, jz) = s[dynamics.RATES : dynamics.ROTORS], c.inertia
        gyroscopic = (jz - jy) * q * o, (jx - jz) * o * p, (jy - jx) * p * q
        torque = self.r @ (np.multiply(c.inertia, change[dynamics.RATES : dynamics.ROTORS]) + gyroscopic)
        push, torque = self.frame.T @ (c.mass * (change[3:6] + [0.0, 0.0, c.gravity])), self.frame.T @ torque
        for _ in range(round(_PERIOD / _STEP)):
            at, _ = bullet.getBasePositionAndOrientation(self.id, **self.client)
            bullet.applyExternalForce(self.id, -1, push, at, bullet.WORLD_FRAME, **self.client)
            bullet.applyExternalTorque(self.id, -1, torque, bullet.WORLD_FRAME, **self.client)
            bullet.stepSimulation(**self.client)
        at, q = bullet.getBasePositionAndOrientation(self.id, **self.client)
        velocity, turning = bullet.getBaseVelocity(self.id, **self.client)
        _, (x, y, z, w) = bullet.multiplyTransforms([0.0, 0.0, 0.0], self.turn, [0.0, 0.0, 0.0], q)
        s[:3], s[3:6] = self.at + self.frame @ at, self.frame @ velocity
        s[dynamics.QUATERNION : dynamics.RATES] = w, x, y, z
        dynamics.rotation(s[dynamics.QUATERNION : dynamics.RATES], self.r)
        s[dynamics.RATES : dynamics.ROTORS] = self.frame @ turning @ self.r
        s[dynamics.ROTORS : dynamics.LOAD] += _PERIOD * change[dynamics.ROTORS : dynamics.LOAD]
        return any(point[9] > 0.0 for point in bullet.getContactPoints(self.id, **self.client))

    def close(self) -> None:
        """Leave Bullet."""
        if self.client:
            bullet.disconnect(**self.client)
