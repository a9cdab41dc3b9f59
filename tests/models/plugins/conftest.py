"""A bare vehicle in MJCF text, built around the two plugins."""

import mujoco
import numpy as np
import pytest

from inclined_landing.models.parameters import load_vehicle

VEHICLE = load_vehicle()
GEARS = {"thrust": "0 0 1 0 0 0", "roll": "0 0 0 1 0 0", "pitch": "0 0 0 0 1 0", "yaw_rate": "0 0 0 0 0 1"}
ROTORS = "inclined_landing.rotors"
ATTITUDE = "inclined_landing.attitude"


def _config(attributes: dict) -> str:
    return "".join(f'<config key="{key}" value="{text}"/>' for key, text in attributes.items())


def actuator(name: str, **attributes: str) -> str:
    """One plugin actuator; `attributes` replace or add XML attributes."""
    rotors = name.startswith("thrust")
    given = {
        "name": name,
        "site": "com",
        "plugin": ROTORS if rotors else ATTITUDE,
        "instance": "rotors" if rotors else "attitude",
        "gear": GEARS.get(name, GEARS["thrust"]),
    }
    if rotors:
        given["actdim"] = "1"
    given |= attributes
    return "<plugin " + " ".join(f'{k}="{v}"' for k, v in given.items() if v is not None) + "/>"


def vehicle_xml(
    *,
    rotors: dict | None = None,
    attitude: dict | None = None,
    actuators: str | None = None,
    integrator: str = "RK4",
    timestep: float = 0.001,
    inertial: str | None = None,
    site: str = '<site name="com"/>',
) -> str:
    """MJCF text; `rotors` and `attitude` are the plugins' attributes."""
    if actuators is None:
        actuators = "".join(map(actuator, GEARS))
    if inertial is None:
        inertia = " ".join(map(repr, VEHICLE.body_inertia))
        inertial = f'pos="0 0 0" mass="{VEHICLE.body_mass!r}" diaginertia="{inertia}"'
    return f"""
    <mujoco>
      <option timestep="{timestep!r}" integrator="{integrator}"
              gravity="0 0 {-VEHICLE.environment_gravity!r}"/>
      <extension>
        <plugin plugin="{ROTORS}">
          <instance name="rotors">{_config(rotors or {})}</instance>
        </plugin>
        <plugin plugin="{ATTITUDE}">
          <instance name="attitude">{_config(attitude or {})}</instance>
        </plugin>
      </extension>
      <worldbody>
        <body name="crazyflie" pos="0 0 1">
          <freejoint/>
          <inertial {inertial}/>
          {site}
          <body name="other" pos="0 0 0.1">
            <joint name="hinge"/>
            <inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>
            <site name="other"/>
          </body>
        </body>
      </worldbody>
      <actuator>{actuators}</actuator>
    </mujoco>"""


class Build:
    """Makes models of the bare vehicle and puts them into a state."""

    vehicle = VEHICLE
    actuator = staticmethod(actuator)
    xml = staticmethod(vehicle_xml)

    def __call__(self, **options) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(vehicle_xml(**options))

    @staticmethod
    def data(model, ctrl=0.0, act=0.0, velocity=(0, 0, 0), quat=(1, 0, 0, 0)) -> mujoco.MjData:
        """MjData with command, lag, world velocity and attitude set, after `mj_forward`."""
        data = mujoco.MjData(model)
        data.ctrl[:] = ctrl
        data.act[:] = act
        data.qvel[:3] = velocity
        data.qpos[3:7] = np.array(quat) / np.linalg.norm(quat)
        mujoco.mj_forward(model, data)
        return data

    @staticmethod
    def run(model, data, duration: float) -> None:
        """Step until `duration` [s] has passed."""
        mujoco.mj_step(model, data, round(duration / model.opt.timestep))


@pytest.fixture(scope="session")
def build() -> Build:
    """Factory of bare vehicle models."""
    return Build()
