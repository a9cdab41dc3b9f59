"""`make_batch`: a task in a plant by name, options checked; `make_for`: a policy with its environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from inclined_landing.envs.batch import BatchEnv, is_whole
from inclined_landing.envs.ids import TASK_CLASSES
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.tasks import make_task
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.parameters import as_vehicle
from inclined_landing.models.plants import check_plant, make_plant
from inclined_landing.models.vehicle import Vehicle

MOST_VEHICLES = 100_000  # of one environment


def make_batch(
    task: str,
    n: int = 64,
    /,
    *,
    plant: str = "mujoco",
    plant_options: dict | None = None,
    vehicle: Vehicle | str | Path | None = None,
    seed: int | None = None,
    **options,
) -> BatchEnv:
    """Return n vehicles on a task as a `BatchEnv`, which `BatchVecEnv` wraps for Stable-Baselines3.

    Args:
        task: name of a task, which may be one imported with `import_task`.
        n: number of vehicles.
        plant: "mujoco", "hybrid" or "analytic".
        plant_options: options of the plant, for example {"integrator": "implicitfast"}.
        vehicle: a vehicle or the path of a vehicle file; by default the shipped one.
        seed: seed of the random starts.
        **options (object): options of the task's class, such as `inclination` or `pwm_centre`.

    Raises:
        UserError: for unknown names and options.
    """
    if not (is_whole(n) and 1 <= n <= MOST_VEHICLES):
        raise UserError(f"num_envs must be an integer from 1 to {MOST_VEHICLES}, not {shown(repr(n), 40)}")
    vehicle = as_vehicle(vehicle)
    check_plant(plant)
    plant_options = {} if plant_options is None else plant_options
    if not isinstance(plant_options, dict):
        raise UserError(f"plant_options must be a dictionary, not {shown(repr(plant_options), 40)}")
    built = make_task(task, vehicle, **options)
    return BatchEnv(built, make_plant(plant, n, built.vehicle, **built.plant_options | plant_options), seed)


def make_for(
    policy: str | Path,
    num_envs: int | None = None,
    *,
    vehicle: Vehicle | str | Path | None = None,
    **options,
) -> tuple[Any, Policy]:
    """Return the Gymnasium environment that a policy was trained for, and the policy: (env, policy).

        env, policy = inclined_landing.make_for("landing", render_mode="rgb_array")
        envs, policy = inclined_landing.make_for("runs/landing-0/final.zip", num_envs=64, plant="hybrid")

    policy: a file, or the name of a shipped one. num_envs: makes a vector environment of this size. vehicle:
    as for `make_batch`. options: of the environment, and of the task if they differ from those of the
    training, such as `inclination` [rad]. Raises UserError for anything else.
    """
    import gymnasium

    vehicle = as_vehicle(vehicle)
    trained = load_policy(policy, vehicle=vehicle).task
    arguments = {"vehicle": vehicle, **trained.options, **options}
    name = f"{__package__}:{TASK_CLASSES[trained.name]}-v0"
    env: Any
    if num_envs is None:
        env = gymnasium.make(name, **arguments)
    else:
        env = gymnasium.make_vec(name, num_envs=num_envs, **arguments)
    return env, load_policy(policy, env.unwrapped.task, inclination=options.get("inclination"))
