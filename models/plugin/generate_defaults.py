"""Write `defaults.h` and `_build.json` from the vehicle file.

usage: generate_defaults.py crazyflie.toml MUJOCO_VERSION OUTPUT_FOLDER
"""

import json
import sys
import tomllib
from pathlib import Path

# plugin attribute -> (table, entry) of the vehicle file
ROTORS = {
    "lag_rate": ("thrust", "lag_rate"),
    "state_gain": ("thrust", "state_gain"),
    "direct_gain": ("thrust", "direct_gain"),
    "drag": ("drag", "coefficients"),
    "pwm_to_force": ("motor", "pwm_to_force"),
    "pwm_to_speed": ("motor", "pwm_to_speed"),
    "motors": ("motor", "count"),
    "arm": ("rotor", "arm"),
    "disc_height": ("rotor", "height"),
    "disc_radius": ("rotor", "radius"),
    "bias": ("effects", "thrust_bias"),
    "fade": ("effects", "thrust_fade"),
    "sag": ("effects", "battery_sag"),
    "sag_reference": ("effects", "battery_reference"),
    "voltage_sensitivity": ("effects", "voltage_sensitivity"),
    "voltage_reference": ("effects", "voltage_reference"),
    "voltage_open": ("effects", "voltage_open"),
    "voltage_drop": ("effects", "voltage_drop"),
    "voltage_discharge": ("effects", "voltage_discharge"),
    "spin_down": ("effects", "spin_down"),
    "body_drag": ("effects", "body_drag"),
    "translational_lift": ("effects", "translational_lift"),
    "axial_inflow": ("effects", "axial_inflow"),
    "ground_effect": ("effects", "ground_effect"),
}
ATTITUDE = {
    "gain": ("attitude", "gain"),
    "time_constant": ("attitude", "time_constant"),
    "bandwidth": ("attitude", "bandwidth"),
    "yaw_bandwidth": ("attitude", "yaw_bandwidth"),
    "trim": ("effects", "attitude_trim"),
    "yaw_drift": ("effects", "yaw_drift"),
}


def main(vehicle_file: Path, mujoco_version: str, folder: Path) -> None:
    vehicle = tomllib.loads(vehicle_file.read_text("utf-8"))
    lines = [
        f"// Generated from {vehicle_file.name}; do not edit.",
        "#pragma once",
        "",
        "namespace inclined_landing::defaults {",
    ]
    build = {"mujoco": mujoco_version}
    for plugin, attributes in (("rotors", ROTORS), ("attitude", ATTITUDE)):
        values = build[plugin] = {}
        for name, (table, entry) in attributes.items():
            value = vehicle[table][entry]["value"]
            values[name] = value
            if isinstance(value, list):
                numbers = ", ".join(repr(float(v)) for v in value)
                lines.append(f"inline constexpr double {name}[] = {{{numbers}}};")
            else:
                lines.append(f"inline constexpr double {name} = {float(value)!r};")
    lines += ["}  // namespace inclined_landing::defaults", ""]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "defaults.h").write_text("\n".join(lines), "utf-8")
    (folder / "_build.json").write_text(json.dumps(build, indent=2) + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))
