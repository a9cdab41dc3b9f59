"""Compiled PPO: its loss and Adam for the networks of `layers`.

The loss is that of Stable-Baselines3: Schulman et al., Proximal Policy Optimization Algorithms, 2017, with
advantages normalised in each minibatch, clipping of the global gradient norm, and Kingma and Ba's Adam.

Symbols of the comments: policy pi with parameters theta, observation o, action a, advantage A, return R,
value V, reward r, discount gamma.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from inclined_landing.train.fast.layers import BLOCK, backward, compiled, forward, inlined, load, once

STATISTICS = ("policy_loss", "value_loss", "entropy", "kl", "clipped")  # of a minibatch
_POLICY_LOSS, _VALUE_LOSS, _ENTROPY, _KL, _CLIPPED = range(len(STATISTICS))
_B, _0, _1 = np.uint64(BLOCK), np.uint64(0), np.uint64(1)
_HALF_LOG_TWO_PI = 0.5 * math.log(2 * math.pi)


class FixedNetwork(NamedTuple):
    """A network for evaluation only."""

    weights: np.ndarray  # (w,) float32
    widths: np.ndarray  # (layers + 1,) uint64
    activations: np.ndarray  # memory for one block of all layers' activations


class LearningNetwork(NamedTuple):
    """A network that learns."""

    weights: np.ndarray  # (w,) float32
    widths: np.ndarray  # (layers + 1,) uint64
    moments: np.ndarray  # (2, w) float32, Adam's
    steps: np.ndarray  # (1,) float64, Adam's until now
    activations: np.ndarray  # memory for one block of all layers' activations
    derivatives: np.ndarray  # of the loss by them
    gradient: np.ndarray  # (w,)


class Bounds(NamedTuple):
    """The bounds of the actions."""

    low: np.ndarray  # (a,) float32
    high: np.ndarray  # (a,) float32


class Drawn(NamedTuple):
    """Actions of n environments."""

    actions: np.ndarray  # (n, a) float32
    clipped: np.ndarray  # (n, a) within the bounds
    log_prob: np.ndarray  # (n,)


class Rollout(NamedTuple):
    """The samples of an update, float32."""

    observations: np.ndarray  # (N, o)
    actions: np.ndarray  # (N, a)
    log_probs: np.ndarray  # (N,) of the policy that drew them
    advantages: np.ndarray  # (N,)
    returns: np.ndarray  # (N,)


class Settings(NamedTuple):
    """The settings of an update."""

    batch: np.uint64  # samples in a minibatch
    actor_learns: bool
    clip: float  # epsilon of the clipped surrogate
    entropy: float  # weight of the entropy in the loss
    values: float  # weight of the values' error in the loss
    largest_norm: float  # of the gradient
    rate: float  # Adam's, and its other constants
    beta1: float
    beta2: float
    epsilon: float


@inlined
def _log_density(deviation, log_std):
    """Return the log density of a normal distribution at a deviation in standard deviations."""
    # log N(a; mu, sigma) = -x^2/2 - log sigma - log(2 pi)/2, x = (a - mu)/sigma
    return np.float32(-0.5) * deviation * deviation - log_std - np.float32(_HALF_LOG_TWO_PI)


@compiled
def act(network, scaling, observations, noise, bounds, drawn):
    """Draw actions for observations (n, o) with standard normal `noise` (n, a), into `drawn`."""
    w, widths, a = network
    n, size = np.uint64(len(observations)), widths[-1]
    log_std = np.uint64(len(w)) - size
    std, rows = np.empty(size, np.float32), np.empty(n, np.uint64)
    for k in range(size):
        std[k] = np.exp(w[log_std + k])
    for k in range(n):
        rows[k] = k
    for first in range(_0, n, _B):
        count = min(_B, n - first)
        load(observations, rows, first, count, scaling, a)
        out = forward(w, widths, a)
        for s in range(count):
            total = np.float32(0)
            for k in range(size):
                mean = a[(out + k) * _B + s]
                # a = mu(o) + sigma noise
                action = mean + std[k] * noise[first + s, k]
                total += _log_density((action - mean) / std[k], w[log_std + k])
                drawn.actions[first + s, k] = action
                action = bounds.low[k] if action < bounds.low[k] else action
                drawn.clipped[first + s, k] = bounds.high[k] if action > bounds.high[k] else action
            drawn.log_prob[first + s] = total


@compiled
def evaluate(network, scaling, observations, values):
    """Write the critic's values (n,) of observations (n, o)."""
    w, widths, a = network
    n = np.uint64(len(observations))
    rows = np.empty(n, np.uint64)
    for k in range(n):
        rows[k] = k
    for first in range(_0, n, _B):
        count = min(_B, n - first)
        load(observations, rows, first, count, scaling, a)
        out = forward(w, widths, a)
        for s in range(count):
            values[first + s] = a[out * _B + s]


@numba.njit(cache=True, nogil=True)
def advantages(rewards, values, starts, last_values, last_dones, gamma, gae_lambda, result):
    """Write the generalised advantage estimates (t, n), in float32 and in the order of SB3's buffer."""
    steps, n = rewards.shape
    gamma32, both = np.float32(gamma), np.float32(gamma * gae_lambda)
    for i in range(n):
        going = np.float32(1) - np.float32(last_dones[i])
        value, total = last_values[i], np.float32(0)
        for t in range(steps - 1, -1, -1):
            # delta_t = r_t + gamma V_t+1 - V_t, A_t = delta_t + gamma lambda A_t+1, within an episode
            delta = rewards[t, i] + gamma32 * value * going - values[t, i]
            total = delta + both * going * total
            result[t, i] = total
            going, value = np.float32(1) - starts[t, i], values[t, i]


@once
def _actor_gradient(actor, rollout, rows, first, last, scaling, settings, statistics):
    """Write the gradient of the clipped surrogate and the entropy over rows[first:last], and STATISTICS."""
    w, widths, g = actor.weights, actor.widths, actor.gradient
    a, d = actor.activations, actor.derivatives
    observations, actions, gains = rollout.observations, rollout.actions, rollout.advantages
    clip, entropy, learns = np.float32(settings.clip), np.float32(settings.entropy), settings.actor_learns
    size, samples = widths[-1], last - first
    log_std = np.uint64(len(w)) - size
    g[:] = 0
    mean, squares = 0.0, 0.0
    for k in range(first, last):
        mean += gains[rows[k]]
    mean /= samples
    for k in range(first, last):
        squares += (gains[rows[k]] - mean) ** 2
    std = math.sqrt(squares / (samples - _1))
    loss, kl, clipped = 0.0, 0.0, 0.0
    low, high = np.float32(1) - clip, np.float32(1) + clip
    per_std, deviations = np.empty(size, np.float32), np.empty(size, np.float32)
    for k in range(size):
        per_std[k] = np.float32(1) / np.exp(w[log_std + k])
    for begin in range(first, last, _B):
        count = min(_B, last - begin)
        load(observations, rows, begin, count, scaling, a)
        out = forward(w, widths, a)
        for k in range(out * _B, (out + size) * _B):
            d[k] = np.float32(0)
        for s in range(count):
            row = rows[begin + s]
            density = np.float32(0)
            for k in range(size):
                deviations[k] = (actions[row, k] - a[(out + k) * _B + s]) * per_std[k]
                density += _log_density(deviations[k], w[log_std + k])
            # A <- (A - mean A)/(std A + 1e-8); ratio = pi(a|o)/pi_old(a|o)
            # L = -min(ratio A, clip(ratio, 1 - eps, 1 + eps) A); KL ~ (ratio - 1) - log ratio
            gain = np.float32((gains[row] - np.float32(mean)) / (np.float32(std) + np.float32(1e-8)))
            log_ratio = density - rollout.log_probs[row]
            ratio = np.exp(log_ratio)
            limited = low if ratio < low else ratio
            limited = high if limited > high else limited
            flat = gain * limited < gain * ratio  # the limit takes the gradient away
            loss -= gain * limited if flat else gain * ratio
            kl += (ratio - np.float32(1)) - log_ratio
            clipped += abs(ratio - np.float32(1)) > clip
            # dL/dlog pi = -ratio A/N; dlog pi/dmu = x/sigma, dlog pi/dlog sigma = x^2 - 1
            slope = np.float32(0) if flat else -gain * ratio / np.float32(samples)
            for k in range(size):
                d[(out + k) * _B + s] = slope * deviations[k] * per_std[k]
                g[log_std + k] += slope * (deviations[k] * deviations[k] - np.float32(1))
        if learns:
            backward(w, widths, a, d, out, g)
    # Entropy of the normal distribution: H = sum(1/2 + log(2 pi)/2 + log sigma)
    total = 0.0
    for k in range(size):
        g[log_std + k] -= entropy
        total += 0.5 + _HALF_LOG_TWO_PI + w[log_std + k]
    statistics[_POLICY_LOSS], statistics[_ENTROPY] = loss / samples, -total
    statistics[_KL], statistics[_CLIPPED] = kl / samples, clipped / samples


@once
def _critic_gradient(critic, rollout, rows, first, last, scaling, settings, statistics):
    """Write the weighted mean square error of the values over rows[first:last], and its gradient."""
    # L = weight mean((V - R)^2)
    w, widths, g = critic.weights, critic.widths, critic.gradient
    a, d = critic.activations, critic.derivatives
    observations, returns = rollout.observations, rollout.returns
    weight = np.float32(settings.values)
    samples = last - first
    g[:] = 0
    loss = 0.0
    for begin in range(first, last, _B):
        count = min(_B, last - begin)
        load(observations, rows, begin, count, scaling, a)
        out = forward(w, widths, a)
        for s in range(_B):
            d[out * _B + s] = np.float32(0)
        for s in range(count):
            error = a[out * _B + s] - returns[rows[begin + s]]
            loss += error * error
            d[out * _B + s] = weight * np.float32(2) * error / np.float32(samples)
        backward(w, widths, a, d, out, g)
    statistics[_VALUE_LOSS] = loss / samples


@inlined
def _square(g):
    """Return the squared norm of g."""
    total = 0.0
    for k in range(np.uint64(len(g))):
        total += g[k] * g[k]
    return total


@inlined
def _adam(learner, share, settings):
    """Do one step of Adam with the gradient multiplied by `share`."""
    # g <- share dL/dw, m <- b1 m + (1 - b1) g, v <- b2 v + (1 - b2) g^2
    # w <- w - rate/(1 - b1^t) m/(sqrt(v)/sqrt(1 - b2^t) + epsilon)
    w, g, mean, square = learner.weights, learner.gradient, learner.moments[0], learner.moments[1]
    learner.steps[0] += 1
    step, rate, beta1, beta2 = learner.steps[0], settings.rate, settings.beta1, settings.beta2
    size = np.float32(rate / (1.0 - beta1**step))
    root = np.float32(math.sqrt(1.0 - beta2**step))
    b1, b2, small = np.float32(1.0 - beta1), np.float32(beta2), np.float32(settings.epsilon)
    rest = np.float32(1.0 - beta2)
    for k in range(np.uint64(len(w))):
        slope = g[k] * share
        mean[k] += b1 * (slope - mean[k])
        square[k] = b2 * square[k] + rest * slope * slope
        w[k] -= size * mean[k] / (np.sqrt(square[k]) / root + small)


@compiled
def update(actor, critic, rollout, order, scaling, settings, statistics):
    """Do the updates of every minibatch of every epoch.

    actor, critic: each a `LearningNetwork`.
    order: (epochs, N) uint64, the order of the samples.
    statistics: (minibatches, 5) float64, STATISTICS.
    """
    samples = np.uint64(order.shape[1])
    k = 0
    for epoch in range(len(order)):
        rows = order[epoch]
        for first in range(_0, samples, settings.batch):
            last = min(first + settings.batch, samples)
            _actor_gradient(actor, rollout, rows, first, last, scaling, settings, statistics[k])
            _critic_gradient(critic, rollout, rows, first, last, scaling, settings, statistics[k])
            k += 1
            # share = min(1, largest norm/(|g| + 1e-6))
            squares = _square(actor.gradient) if settings.actor_learns else 0.0
            squares += _square(critic.gradient)
            share = settings.largest_norm / (math.sqrt(squares) + 1e-6)
            share = np.float32(1.0 if share > 1.0 else share)
            if settings.actor_learns:
                _adam(actor, share, settings)
            _adam(critic, share, settings)
