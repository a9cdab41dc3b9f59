"""An exported policy in NumPy; needs nothing else, and not the package that wrote it.

    from landing_policy import LandingPolicy

    policy = LandingPolicy("policy.npz")  # compares its answers with the test vectors in the file
    policy.reset()  # when a flight begins
    action = policy.act(observation)  # every control period
    pwm, roll, pitch, yaw_rate = policy.commands(action)  # PWM, rad, rad, rad/s

contract.json, next to it, describes the entries of an observation.
"""

import numpy as np

TOLERANCE = 1e-5  # of actions


class LandingPolicy:
    """A policy from a file `policy.npz`.

    With a history the policy is given, behind the present observation, the last K steps, the latest first,
    each as its observation and the action that answered it; `act` keeps them.

    Raises ValueError when the file's own test vectors are not met.
    """

    def __init__(self, path="policy.npz"):
        with np.load(path, allow_pickle=False) as file:
            self._numbers = {name: file[name] for name in file.files}
        n = self._numbers
        self.steps, self.observations, self.actions = (int(k) for k in n["sizes"])
        self.inputs = len(n["centre"])
        layers = int(n["layers"])
        self._layers = [(n[f"weight_{k}"], n[f"bias_{k}"]) for k in range(layers)]
        self._relu = str(n["activation"]) == "ReLU"
        self.reset()
        error = self.self_test()
        if not error <= TOLERANCE:
            raise ValueError(f"{path} fails its self test: an action is off by {error:.2g}")

    def reset(self):
        """Clear the history; call it before the first step of each flight."""
        self._past = None

    def act(self, observation):
        """Return the action (a,) float32 in [-1, 1] for an observation (o,), and append both to the history.

        Raises ValueError for a wrong shape, NaN or infinity; the history then does not change.
        """
        observation = np.asarray(observation, np.float32)
        if observation.shape != (self.observations,):
            raise ValueError(
                f"an observation must have shape ({self.observations},), not {observation.shape}"
            )
        past = self._past
        if past is None:
            first = np.concatenate([observation, np.zeros(self.actions, np.float32)])
            past = np.tile(first, self.steps)
        action = self.infer(np.concatenate([observation, past]))
        if self.steps:
            self._past = np.concatenate([observation, action, past])[: len(past)]
        return action

    def infer(self, inputs):
        """Return actions (..., a) float32 for inputs (..., i), history included, without remembering them."""
        inputs, n = np.asarray(inputs, np.float32), self._numbers
        if inputs.shape[-1:] != (self.inputs,):
            raise ValueError(f"an input must have {self.inputs} numbers, not shape {inputs.shape}")
        if not np.isfinite(inputs).all():
            raise ValueError("an observation is NaN or infinite")
        x = np.clip((inputs - n["centre"]) / n["scale"], -n["limit"], n["limit"])
        for k, (weight, bias) in enumerate(self._layers):
            if k:
                x = np.maximum(x, 0) if self._relu else np.tanh(x)
            x = x @ weight + bias
        if n["squashed"]:
            x = np.tanh(np.clip(x, -n["bound"], n["bound"]))
        if not np.isfinite(x).all():
            raise ValueError("an observation exceeds the range of float32")
        return np.clip(x, np.float32(-1), np.float32(1))

    def commands(self, action):
        """Return PWM, roll, pitch [rad] and yaw rate [rad/s] (4,) of an action (a,), 0 by default."""
        action, result = np.asarray(action, float), np.zeros(4)
        if action.shape != (self.actions,) or not np.isfinite(action).all():
            raise ValueError(f"an action must be {self.actions} finite numbers")
        action = np.clip(action, -1.0, 1.0)
        for a, (column, centre, span, low, high, idle) in zip(action, self._numbers["channels"]):
            if not a <= idle:
                result[int(column)] = min(max(centre + span * a, low), high)
        return result

    def self_test(self):
        """Return the largest deviation of an action from the file's test vectors; clears the history."""
        self.reset()
        vectors = zip(self._numbers["vector_observations"], self._numbers["vector_actions"])
        error = max(float(np.abs(self.act(observation) - wanted).max()) for observation, wanted in vectors)
        self.reset()
        return error
