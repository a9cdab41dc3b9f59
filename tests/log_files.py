"""Files of every kind of flight log, written from a flight."""

import struct
import zlib
from pathlib import Path

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from inclined_landing.eval.logs import FlightLog


def a_log(m=40, **changes) -> FlightLog:
    random = np.random.default_rng(0)
    values = {
        "name": "a",
        "t": np.arange(m) / 100,
        "position": random.normal(size=(m, 3)),
        "attitude": random.normal(size=(m, 3)) * 0.1,
        "command": np.c_[random.uniform(3e4, 5e4, m), random.normal(size=(m, 3)) * 0.1],
    }
    return FlightLog(**{**values, **changes})


def firmware_values(log: FlightLog) -> dict[str, np.ndarray]:
    """The firmware's variables for a flight: degrees, ZYX, pitch inverted."""
    roll, pitch, yaw = log.attitude.T
    rotation = Rotation.from_euler("ZXY", np.stack([yaw, roll, pitch], axis=1))
    yaw, pitch, roll = rotation.as_euler("ZYX", degrees=True).T
    # Rx Ry as Rz Ry Rx; the rest in yaw is nobody's command.
    asked = Rotation.from_euler("XY", log.command[:, 1:3]).as_euler("ZYX", degrees=True)
    return {
        **{f"stateEstimate.{axis}": column for axis, column in zip("xyz", log.position.T)},
        "stabilizer.roll": roll,
        "stabilizer.pitch": -pitch,
        "stabilizer.yaw": yaw,
        "controller.cmd_thrust": log.command[:, 0],
        "controller.roll": asked[:, 2],
        "controller.pitch": -asked[:, 1],
        "controller.yawRate": np.degrees(log.command[:, 3]),
        "pm.vbat": np.linspace(4.0, 3.7, len(log)),
    }


def sd_card(
    values: dict[str, np.ndarray], t: np.ndarray, version: int, slow: dict[str, float], number: int = 3
) -> bytes:
    """A micro-SD log: `values` at fixed frequency, and an event `slow` of that number with each tenth row."""

    def names(variables) -> bytes:
        return b"".join(f"{name}(f)".encode() + b"\0" for name in variables)

    data = struct.pack("<BHH", 0xBC, version, 2)
    data += struct.pack("<H", 0xFFFF) + b"fixedFrequency\0" + struct.pack("<H", len(values)) + names(values)
    data += struct.pack("<H", number) + b"slow\0" + struct.pack("<H", len(slow)) + names(slow)
    stamp = (
        (lambda s: struct.pack("<I", round(1e3 * s)))
        if version == 1
        else (lambda s: struct.pack("<Q", round(1e6 * s)))
    )
    for i, time in enumerate(t):
        row = [column[i] for column in values.values()]
        data += struct.pack("<H", 0xFFFF) + stamp(5 + time) + struct.pack(f"<{len(row)}f", *row)
        if i % 10 == 0:
            data += (
                struct.pack("<H", number) + stamp(5 + time) + struct.pack(f"<{len(slow)}f", *slow.values())
            )
    return data + struct.pack("<I", zlib.crc32(data))


def write_bag(path: Path, log: FlightLog, ros: int, vehicles=("cf1",)) -> Path:
    """Pose and battery stamped, commands not: as Crazyswarm2 publishes them."""
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    types = store.types
    vector, time = types["geometry_msgs/msg/Vector3"], types["builtin_interfaces/msg/Time"]

    def header(seconds):
        stamp = time(sec=int(seconds), nanosec=round(1e9 * (seconds % 1)))
        more = {"seq": 0} if ros == 1 else {}
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="world", **more)

    roll, pitch, yaw = log.attitude.T
    rotation = Rotation.from_euler("ZXY", np.stack([yaw, roll, pitch], axis=1)).as_quat()
    writer = rosbag1.Writer(path) if ros == 1 else rosbag2.Writer(path, version=8)
    with writer:
        for vehicle in vehicles:
            pose = writer.add_connection(f"/{vehicle}/pose", "geometry_msgs/msg/PoseStamped", typestore=store)
            sent = writer.add_connection(
                f"/{vehicle}/cmd_vel_legacy", "geometry_msgs/msg/Twist", typestore=store
            )
            for i, now in enumerate(1000.0 + log.t):
                message = types["geometry_msgs/msg/PoseStamped"](
                    header=header(now),
                    pose=types["geometry_msgs/msg/Pose"](
                        position=types["geometry_msgs/msg/Point"](*log.position[i]),
                        orientation=types["geometry_msgs/msg/Quaternion"](*rotation[i]),
                    ),
                )
                pwm, _, _, rate = log.command[i]
                _, pitch_sent, roll_sent = Rotation.from_euler("XY", log.command[i, 1:3]).as_euler("ZYX")
                twist = types["geometry_msgs/msg/Twist"](
                    linear=vector(np.degrees(pitch_sent), np.degrees(roll_sent), pwm),
                    angular=vector(0.0, 0.0, -np.degrees(rate)),
                )
                encode = store.serialize_ros1 if ros == 1 else store.serialize_cdr
                # The bag receives the stamped pose 30 ms late; that must not matter.
                writer.write(pose, round(1e9 * (now + 0.03)), encode(message, message.__msgtype__))
                writer.write(sent, round(1e9 * now), encode(twist, twist.__msgtype__))
    return path
