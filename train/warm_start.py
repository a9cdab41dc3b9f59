"""Training that starts from a policy: of the same task, with its exploration and critic, or of another task.

Touchdown training starts from the landing policy, which is first taught to cut the motors. A landing policy
has never kept the motors at idle, and exploration does not find fifteen idle steps in a row. The actor
therefore takes over the landing policy's weights and then imitates it, except that the motors go to idle in
the goal box and close to the slope (the paper's motor cut, without its external signal). The states are those
that the learner itself visits (DAgger). The comparison with the landing policy and a motor cut then shows the
contribution of reinforcement learning.

In space, also over moving platforms, touchdown training starts instead from a feedback law (`descent`), which
is imitated in the same way.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO

from inclined_landing.envs import policy_file, sb3_file
from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.history import input_centre, input_scale
from inclined_landing.envs.ids import DESCENT
from inclined_landing.envs.policy import Policy, load_policy, trained_task
from inclined_landing.envs.tasks import StepContext, Task
from inclined_landing.envs.tasks.landing import CONTACT_LIMIT, GOAL_SIZE, LEAVE_LIMIT
from inclined_landing.envs.tasks.touchdown import (
    FRICTION,
    IDLE_ACTION,
    RESTITUTION,
    InclinedTouchdown,
    TouchdownConditions,
)
from inclined_landing.models import surface
from inclined_landing.models.attitude import PITCH, ROLL, X, Y, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.train.descent import Descent

CRITIC_FIRST = 65_536  # environment steps in which the actor is left alone
CUT_HEIGHT = 0.08  # m over the surface, of the centre of mass
_IDLE = IDLE_ACTION - 0.4  # imitated idle action: remains below IDLE_ACTION under exploration noise
_LOWEST = IDLE_ACTION + 0.05  # lower clip of the imitated thrust action; -1 commands idle
_ROUNDS, _ROUNDS_OF_LAW = 4, 8  # of DAgger; a law needs more than a policy, whose weights are taken over
_STEPS = 200  # control steps of a vehicle in a round
_EPOCHS = 15  # passes in a round over all states so far
_BATCH, _RATE = 1024, 1e-3  # minibatch, learning rate of Adam
_NOISE = 0.2  # standard deviation of the noise on the actions


def teacher(name: str, task: Task, vehicle: Path | None) -> Policy | Descent:
    """Return the policy to start from, of `task` or of the task whose policy its training starts with.

    name: a file or a shipped policy, or `DESCENT` for the law. vehicle: the run's file, None for the shipped.
    Raises UserError for any other policy.
    """
    if name == DESCENT:
        if not (isinstance(task, InclinedTouchdown) and not task.is_planar):
            raise UserError(f"--from {name} is only for touchdown in 3D, not for this {task.name} task")
        return Descent(task)
    usual = task.training.start_from
    if usual == DESCENT:
        usual = "landing-nominal"  # the policy with which training in the plane starts
    wanted = trained_task(usual) if usual and trained_task(name) != task.name else task.name
    return load_policy(name, wanted, vehicle=vehicle, inclination=task.options.get("inclination"))


def take_over(model: PPO, policy: Policy) -> None:
    """Copy a policy's weights into the model's actor; raises UserError if they do not fit.

    For the same task, the exploration noise is copied too, and the critic if the file has it. The model may
    have a longer history than the policy: the weights of its new inputs are initially 0. If the task commands
    a different thrust for the same action, the last layer is rewritten: action a becomes gain a + offset,
    which is the same PWM. Only actions that exceeded the old span are then clipped at the new one. If the
    task centres observations differently, as over a platform of another height, the first layers are
    rewritten.
    """
    actor = [layer for layer in model.policy.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    actor.append(model.policy.action_net)
    task = model.env.env.task
    _check_task(policy, task)
    new_inputs = (task.history - policy.task.history) * (len(task.observation_names) + len(task.action_names))
    first, *others = policy.weights
    shift = _centre_shift(policy, task)
    biases = [policy.biases[0] + shift @ first, *policy.biases[1:]]
    weights = [np.pad(first, ((0, new_inputs), (0, 0))), *others]
    _check_network(policy, task, [w.shape for w in weights], [(x.in_features, x.out_features) for x in actor])
    gain, offset = task.thrust_of(policy.task)
    row = task.action_names.index("thrust") if (gain, offset) != (1.0, 0.0) else None
    if row is not None and policy.task.history:
        raise UserError(
            f"policy {policy.path} observes its past actions and can only be continued with its own PWM"
        )
    with torch.no_grad():
        for layer, weight, bias in zip(actor, weights, biases):
            layer.weight.copy_(torch.as_tensor(weight.T))
            layer.bias.copy_(torch.as_tensor(bias))
        if row is not None:
            actor[-1].weight[row] *= gain
            actor[-1].bias[row] = gain * actor[-1].bias[row] + offset
        if policy.task.name == task.name:
            _take_exploration_and_critic(model, policy, new_inputs, shift)
            if row is not None:
                model.policy.log_std[row] += np.log(gain)


def _check_task(policy: Policy, task: Task) -> None:
    """Raise UserError if `task` has fewer inputs than `policy` was trained with, or another PWM."""
    before = policy.task
    if before.observation_names != task.observation_names:
        others = sorted(set(before.observation_names) ^ set(task.observation_names))
        raise UserError(
            f"policy {policy.path} has other observations than this run ({', '.join(others)}); "
            "give the --dimensions, --steepest and --fastest that it was trained with"
        )
    how = "with" if before.observe_vehicle else "without"
    for fits, remedy in (
        (before.history <= task.history, f"needs --history {before.history} or more"),
        (before.observe_vehicle == task.observe_vehicle, f"must be continued {how} --observe-vehicle"),
        (
            before.history == task.history or not before.observe_vehicle,
            "observes its vehicle's parameters and can only be continued with its own history",
        ),
        (
            before.per_vehicle_hover == task.per_vehicle_hover,
            "can only be continued with its own PWM at action 0",
        ),
    ):
        if not fits:
            raise UserError(f"policy {policy.path} {remedy}")


def _check_network(policy: Policy, task: Task, shapes: list[tuple], wanted: list[tuple]) -> None:
    """Raise UserError if the policy's network differs from the model's; shapes: of the layers' weights."""
    if shapes != wanted or policy.activation != "Tanh" or policy.squashed:
        raise UserError(
            f"policy {policy.path} has a different network than training uses; it must be {wanted}"
        )
    if not np.array_equal(policy.scale, np.float32(input_scale(task)[: len(policy.scale)])):
        raise UserError(f"policy {policy.path} was trained with a different scaling of observations")


def _centre_shift(policy: Policy, task: Task) -> np.ndarray:
    """Return the offset of the policy's scaled inputs (i,) from the task's: 0 for the same centre."""
    return (np.float32(input_centre(task)[: len(policy.centre)]) - policy.centre) / policy.scale


def _take_exploration_and_critic(model: PPO, policy: Policy, new_inputs: int, shift: np.ndarray) -> None:
    """Copy the standard deviation of the actions, and the critic if it is in the policy's file."""
    with policy_file.open_file(policy.path) as archive:
        found = sb3_file.read_tensors(archive, policy.path)
    for name, tensor in model.policy.state_dict().items():
        if name != "log_std" and "value_net" not in name:
            continue
        value = torch.as_tensor(found[name]) if name in found else tensor
        first = found.get("mlp_extractor.value_net.0.weight")
        if name == "mlp_extractor.value_net.0.weight" and value.ndim == 2:
            value = torch.nn.functional.pad(value, (0, new_inputs))
        elif name == "mlp_extractor.value_net.0.bias" and name in found and shift.any():
            value = value + torch.as_tensor(first @ shift, dtype=value.dtype)
        if value.shape != tensor.shape:
            raise UserError(f"policy {policy.path} has a different {name} than training uses")
        tensor.copy_(value)


def lesson(context: StepContext, landing: Policy, observation: np.ndarray | None = None) -> np.ndarray:
    """Return the actions (n, a) to imitate in n states, over their platforms.

    observation (n, o): the landing policy's inputs, including its history if it has one.
    """
    task = landing.task
    v, state, platform = task.vehicle, context.state, context.platform
    observation = task.observe(context) if observation is None else observation
    action = landing.predict(observation).astype(float)
    action[:, 0] = np.maximum(action[:, 0], _LOWEST)
    place = surface.on_platform(state, platform)
    over = (place[:, Z] < CUT_HEIGHT) & (np.abs(place[:, X]) < v.slab_half_length)
    on_slope = platform[:, ROLL : PITCH + 1]  # roll and pitch of a vehicle that stands there
    if task.observes_slope:
        over &= np.abs(place[:, Y]) < 0.5 * v.platform_depth
        on_slope = surface.heading_frame(state, platform)[:, surface.SLOPE_ROLL :]
    idle = over | task.in_goal(state, GOAL_SIZE, platform)
    angles = {"roll": on_slope[:, 0], "pitch": on_slope[:, 1]}
    action[idle, 0] = _IDLE
    for column, name in enumerate(task.action_names[1:], 1):
        action[idle, column] = angles[name][idle] / (v.attitude_gain * v.command_angle_limit)
    return action


def teach(model: PPO, env: BatchEnv, teacher: Policy | Descent, seed: int) -> None:
    """Teach what the teacher's weights do not contain: a touchdown's motor cut, or the whole law."""
    if isinstance(teacher, Descent):
        teach_law(model, env, lambda context, _: teacher(context, _IDLE), seed, _ROUNDS_OF_LAW)
    elif isinstance(env.task, InclinedTouchdown) and teacher.task.name != env.task.name:
        known = len(teacher.centre)  # the learner may have a longer history
        teach_law(model, env, lambda context, seen: lesson(context, teacher, seen[:, :known]), seed)


def teach_law(
    model: PPO,
    env: BatchEnv,
    law: Callable[[StepContext, np.ndarray], np.ndarray],
    seed: int,
    rounds: int = _ROUNDS,
) -> None:
    """Teach the model's actor a law on the states that it visits in `env`, whose conditions are reset. law:
    returns actions (n, a) from the states and the actor's inputs (n, o).
    """
    rng, shuffle = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    actor = model.policy
    before = env.task.conditions
    env.task.conditions = TouchdownConditions(
        contact_limit=CONTACT_LIMIT,
        leave_limit=LEAVE_LIMIT,
        steep=0.3,
        close=0.3,
        friction=FRICTION,
        restitution=RESTITUTION,
    )
    learned = [p for name, p in actor.named_parameters() if "policy_net" in name or "action_net" in name]
    optimizer = torch.optim.Adam(learned, lr=_RATE)
    seen, taught = [], []
    env.reset()
    for lap in range(rounds):
        for _ in range(_STEPS):
            seen.append(env.observe())
            taught.append(law(StepContext(env.plant.state, platform=env.plant.platform), seen[-1]))
            action = taught[-1] if lap == 0 else _mean(actor, torch.as_tensor(seen[-1])).detach().numpy()
            step = env.step(action + rng.normal(0.0, _NOISE, action.shape))
            done = step.terminated | step.truncated
            if done.any():
                env.reset(np.flatnonzero(done))
        inputs = torch.as_tensor(np.concatenate(seen))
        outputs = torch.as_tensor(np.concatenate(taught).astype(np.float32))
        for _ in range(_EPOCHS):
            for rows in torch.randperm(len(inputs), generator=shuffle).split(_BATCH):
                loss = ((_mean(actor, inputs[rows]) - outputs[rows]) ** 2).mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
    env.task.conditions = before


def _mean(actor, observations: torch.Tensor) -> torch.Tensor:
    return actor.get_distribution(observations).distribution.mean
