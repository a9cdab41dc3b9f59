"""What both plugins owe the engine: commands, switches, state, several models at once."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import mujoco
import mujoco.batch
import numpy as np
import pytest

NAMES = ("thrust", "roll", "pitch", "yaw_rate")


def all_actuators(build, **attributes):
    return "".join(build.actuator(name, **attributes) for name in NAMES)


def fly(model, data, commands):
    """Step once per row of `commands` (k, 4); returns qpos, qvel and act of every step, joined."""
    rows = []
    for row in commands:
        data.ctrl[:] = row
        mujoco.mj_step(model, data)
        rows.append(np.concatenate([data.qpos, data.qvel, data.act]))
    return np.array(rows)


def commands(k=50, seed=0):
    """(k, 4) random commands within the vehicle's bounds."""
    low, high = np.array([0, -0.5, -0.5, -3]), np.array([60000, 0.5, 0.5, 3])
    return np.random.default_rng(seed).uniform(low, high, (k, 4))


@pytest.mark.parametrize("flag", ["enable", "disable"])
def test_command_is_clamped_to_ctrlrange_unless_disabled(build, flag):
    model = build(actuators=all_actuators(build, ctrlrange="-0.2 0.2"))
    model.opt.disableflags = mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL if flag == "disable" else 0
    outside = build.data(model, [900, 0.5, -0.5, 2])
    inside = build.data(model, [0.2, 0.2, -0.2, 0.2])
    same = np.array_equal(outside.actuator_force, inside.actuator_force)
    assert same == (flag == "enable")
    assert (outside.act_dot[0] == inside.act_dot[0]) == (flag == "enable")


def test_command_that_is_not_a_number_counts_as_zero(build):
    model = build()
    data = build.data(model, [np.nan, np.inf, 0, 0], 1000)
    zero = build.data(model, 0.0, 1000)
    np.testing.assert_array_equal(data.actuator_force, zero.actuator_force)
    np.testing.assert_array_equal(data.act_dot, zero.act_dot)


@pytest.mark.parametrize(
    "integrator, interp", [("implicitfast", "zoh"), ("RK4", "linear"), ("implicitfast", "linear")]
)
def test_delay_is_the_engines(build, integrator, interp):
    """Beside a native motor with the same delay, the direct thrust is its force times the gain.

    Not so for held commands under RK4, whose last stage reads the next command in the engine.
    """
    delayed = {"delay": "0.003", "nsample": "3", "interp": interp}
    attributes = " ".join(f'{key}="{value}"' for key, value in delayed.items())
    native = f'<motor name="native" site="com" gear="0 0 0 0 0 0" {attributes}/>'
    model = build(
        rotors={"state_gain": "0", "direct_gain": "2"},
        actuators=build.actuator("thrust", **delayed) + build.actuator("roll", **delayed) + native,
        integrator=integrator,
    )
    data = build.data(model)
    torques = []
    for k in range(12):
        data.ctrl[:] = [k, 0.1 if k >= 4 else 0, k]
        mujoco.mj_step(model, data)
        assert data.actuator_force[0] == 2 * data.actuator_force[2]
        torques.append(data.actuator_force[1])
    # the command given at step 4 is first felt three steps later
    assert np.flatnonzero(torques)[0] in ((7,) if integrator != "RK4" else (6, 7))


@pytest.mark.parametrize("integrator", ["RK4", "implicitfast"])
@pytest.mark.parametrize("delay", [0.0004, 0.001, 0.0025, 0.004])
def test_a_held_command_is_delayed_exactly(build, integrator, delay):
    """Of a command that steps once, the delayed one has its exact average over every time step."""
    attributes = {"delay": repr(delay), "nsample": "4"}
    model = build(
        rotors={"state_gain": "0", "direct_gain": "2"},
        actuators=build.actuator("thrust", **attributes) + build.actuator("roll"),
        integrator=integrator,
    )
    data = build.data(model)
    forces = []
    for k in range(8):
        data.ctrl[0] = float(k >= 2)
        mujoco.mj_step(model, data)
        forces.append(data.actuator_force[0])
    begin = 0.001 * np.arange(8)
    share = np.clip((begin + 0.001 - (0.002 + delay)) / 0.001, 0, 1)
    np.testing.assert_allclose(forces, 2 * share, atol=1e-9)


def test_disabled_group_neither_pushes_nor_drags_nor_spins(build):
    actuators = "".join(build.actuator(n, group=str(i)) for i, n in enumerate(NAMES))
    model = build(actuators=actuators)
    for i in range(4):
        model.opt.disableactuator = 1 << i
        data = build.data(model, [30000, 0.1, 0.1, 1], 2000, velocity=(1, 1, 1))
        assert list(data.actuator_force == 0) == [k == i for k in range(4)]
        assert np.any(data.qfrc_passive != 0) == (i != 0)
        assert (data.act_dot[0] == 0) == (i == 0)
    mujoco.mj_step(model, data)
    model.opt.disableactuator, model.opt.disableflags = 0, mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data = build.data(model, [30000, 0.1, 0.1, 1], 2000, velocity=(1, 1, 1))
    assert not data.actuator_force.any() and not data.qfrc_passive.any()


def test_replay_from_the_saved_state_or_in_a_copy_is_bit_equal(build):
    model = build()
    data = build.data(model, 0.0)
    fly(model, data, commands(20, seed=1))
    signature = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, signature))
    mujoco.mj_getState(model, data, state, signature)
    copies = copy.copy(data), pickle.loads(pickle.dumps(data))
    first = fly(model, data, commands())
    mujoco.mj_setState(model, data, state, signature)
    np.testing.assert_array_equal(fly(model, data, commands()), first)
    fresh = mujoco.MjData(model)
    mujoco.mj_setState(model, fresh, state, signature)
    del data
    for other in (fresh, *copies):
        np.testing.assert_array_equal(fly(model, other, commands()), first)


def test_saved_model_keeps_its_attributes(build, tmp_path):
    model = build(rotors={"lag_rate": "4"}, attitude={"gain": "0.5"})
    mujoco.mj_saveModel(model, str(tmp_path / "vehicle.mjb"))
    again = mujoco.MjModel.from_binary_path(str(tmp_path / "vehicle.mjb"))
    np.testing.assert_array_equal(
        fly(again, mujoco.MjData(again), commands()), fly(model, mujoco.MjData(model), commands())
    )


def variants(build, count):
    return [
        build(rotors={"lag_rate": repr(5.0 + i)}, attitude={"gain": repr(0.5 + 0.01 * i)})
        for i in range(count)
    ]


def test_models_with_different_attributes_side_by_side(build):
    """More of them than one thread remembers parsed texts for, in turn and in one batch."""
    models = variants(build, 40)
    alone = [fly(model, mujoco.MjData(model), commands(5)) for model in models]
    data, batch = [mujoco.MjData(model) for model in models], mujoco.batch.Batch(models[0], len(models), 2)
    batch.set_models(models)
    qpos, ctrl = batch.bind("qpos"), batch.bind("ctrl")
    for k, row in enumerate(commands(5)):
        ctrl[:] = row
        batch.step()
        for i, model in enumerate(models):
            np.testing.assert_array_equal(fly(model, data[i], row[None])[0], alone[i][k])
            np.testing.assert_array_equal(qpos[i], data[i].qpos)
    assert len({row[-1, -1] for row in alone}) == len(models)


def test_model_in_reused_memory_does_not_inherit_attributes(build):
    for gain in ("1e-4", "2e-4", "3e-4", "1e-4"):  # same length of text, memory freed each time
        model = build(rotors={"state_gain": gain})
        assert build.data(model, 0.0, 1000).actuator_force[0] == 1000 * float(gain)
        del model


def test_models_on_several_threads(build):
    models = variants(build, 8)
    alone = [fly(model, mujoco.MjData(model), commands()) for model in models]
    with ThreadPoolExecutor(4) as pool:
        threaded = pool.map(lambda m: fly(m, mujoco.MjData(m), commands()), models * 4)
    for result, single in zip(threaded, alone * 4, strict=True):
        np.testing.assert_array_equal(result, single)
