"""The network of a file that Stable-Baselines3's PPO saved, read with torch and without running its code.

Such a file contains little information on what its policy observed and commanded in training. Anything that
may differ from the task is refused with the remedy: `save_policy`, which has access to the model and its
environment.
"""

from __future__ import annotations

import pickletools
import re
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.envs.policy_file import ACTIVATIONS, open_zip, read_member, read_table
from inclined_landing.models.base.errors import UserError, optional, shown

_HEADER, _TENSORS = "data", "policy.pth"  # members that Stable-Baselines3 writes
_LARGEST_PICKLE = 1_000_000  # bytes
_NAMES = {  # all that the pickle of a table of dense float tensors names
    *(
        "collections OrderedDict",
        "torch._utils _rebuild_tensor_v2",
        "torch FloatStorage",
        "torch DoubleStorage",
    ),
}
_POLICIES = "stable_baselines3.common.policies"  # module of PPO's policies
_EXTRACTORS = (
    r"<class '(stable_baselines3\.[\w.]+\.FlattenExtractor|inclined_landing\.[\w.]+\.ScaledObservation)'>"
)
_LIMIT = 10.0  # of `features.ScaledObservation`
_BOUNDS = {"observation_space": ("-inf", "inf"), "action_space": (r"-1(\.0*)?", r"1(\.0*)?")}
_ACTIVATION = "<class 'torch.nn.modules.activation."
_HIDDEN, _OUTPUT, _SCALING = "mlp_extractor.policy_net.", "action_net", "features_extractor."
# Tensors that are read, or that no action without noise depends on.
_KNOWN = (
    r"((pi_|vf_)?features_extractor|mlp_extractor\.(policy|value)_net|action_net|value_net|log_std)(\.|$)"
)


def read_network(archive: zipfile.ZipFile, path: Path) -> dict[str, Any]:
    """Return the fields of `Policy` that make up its network.

    Raises UserError for a file of another algorithm, or if the observations or actions of its network differ
    from the task's.
    """
    header = read_table(archive, _HEADER, path)
    options = _table(header, "policy_kwargs")
    if foreign := _foreign(header):
        raise _refused(path, foreign)
    tensors = read_tensors(archive, path)
    if unknown := next((name for name in tensors if not re.match(_KNOWN, name)), None):
        raise _refused(path, f"has {shown(unknown, 60)} in its network, which cannot be evaluated")
    extractor = {name.removeprefix(_SCALING) for name in tensors if name.startswith(_SCALING)}
    numbers = {name.removeprefix(_HIDDEN).split(".")[0] for name in tensors if name.startswith(_HIDDEN)}
    plain = all(re.fullmatch("[0-9]{1,3}", number) for number in numbers)
    layers = [*(f"{_HIDDEN}{k}" for k in sorted(numbers, key=int)), _OUTPUT] if plain else [""]
    complete = all(f"{layer}.{part}" in tensors for layer in layers for part in ("weight", "bias"))
    if not complete or extractor not in (set(), {"centre", "scale"}):
        raise _refused(path, "has another network than dense layers")
    weights = tuple(np.ascontiguousarray(tensors[f"{layer}.weight"].T) for layer in layers)
    inputs = len(weights[0]) if weights[0].ndim else 0
    named = options.get("activation_fn", f"{_ACTIVATION}Tanh'>")
    activation = str(named).removeprefix(_ACTIVATION).removesuffix("'>")
    if activation not in ACTIVATIONS:
        raise _refused(path, f"has the activation {shown(named, 80)}, not {' or '.join(ACTIVATIONS)}")
    return {
        "centre": tensors[f"{_SCALING}centre"] if extractor else np.zeros(inputs),
        "scale": tensors[f"{_SCALING}scale"] if extractor else np.ones(inputs),
        "limit": _LIMIT if extractor else np.inf,
        "weights": weights,
        "biases": tuple(tensors[f"{layer}.bias"] for layer in layers),
        "activation": activation,
        "squashed": options.get("squash_output") is True,  # with `use_sde`
        "bound": np.inf,
    }


def _refused(path: Path, why: str) -> UserError:
    return UserError(
        f"policy {path} {why}; load the model with its environment and save it with save_policy(model, path)"
    )


def _table(header: dict, name: str) -> dict:
    value = header.get(name)
    return value if isinstance(value, dict) else {}


def _foreign(header: dict) -> str | None:
    """Return what a header states beyond tensors and task, as in "policy X was ...", or None."""
    if not header:
        return "is damaged, or not a policy file"
    module = _table(header, "policy_class").get("__module__")
    if module != _POLICIES or "clip_range" not in header:
        return "is neither a file of this package nor one of Stable-Baselines3's PPO with a standard policy"
    if header.get("_last_original_obs") is not None:
        return "was trained with VecNormalize, whose statistics it does not hold"
    extractor = _table(header, "policy_kwargs").get("features_extractor_class")
    if extractor is not None and not re.fullmatch(_EXTRACTORS, str(extractor)):
        return f"has the features extractor {shown(extractor, 80)}, which cannot be evaluated"
    for name, ends in _BOUNDS.items():
        for end, limit in zip(("low", "high"), ends):
            text = _table(header, name).get(end)
            if not re.fullmatch(rf"\[({limit}|\s)*\]", str(text)):
                return f"was trained in an {name.replace('_', ' ')} other than the task's (a wrapper?)"
    return None


def read_tensors(archive: zipfile.ZipFile, path: Path) -> dict[str, np.ndarray]:
    """Return all tensors of Stable-Baselines3's policy by name, including the critic, in float64.

    Raises UserError for anything but a table of dense tensors of finite floats.
    """
    with optional():
        import torch
    if _TENSORS not in archive.namelist():
        raise _refused(path, f"is not a policy of Stable-Baselines3: it lacks {_TENSORS}")
    what = f"policy {path}: {_TENSORS} in it"
    content = read_member(archive, _TENSORS, f"policy {path}")
    inner = open_zip(content, what)
    pickles = [name for name in inner.namelist() if name.endswith("/data.pkl")]
    if len(pickles) != 1 or any(member.compress_type != zipfile.ZIP_STORED for member in inner.infolist()):
        raise UserError(f"{what} is not a file that torch saved")
    pickled = read_member(inner, pickles[0], what, _LARGEST_PICKLE)
    try:
        named = {str(value) for code, value, _ in pickletools.genops(pickled) if code.name == "GLOBAL"}
        if strange := sorted(named - _NAMES):
            raise UserError(f"{what} holds {shown(strange[0], 60)}; only dense tensors of floats are read")
        with tempfile.NamedTemporaryFile(suffix=".pth") as file:
            file.write(content)
            file.flush()
            # Mapped: whatever sizes the pickle states, torch reads and allocates nothing beyond the file.
            found = torch.load(file.name, "cpu", mmap=True, weights_only=True)
            if sum(tensor.numel() for tensor in found.values()) > len(content):
                raise UserError(f"{what} states more numbers than it holds")
            tensors = {
                str(name): np.array(tensor.detach().double().numpy()) for name, tensor in found.items()
            }
    except UserError:
        raise
    except Exception as error:  # whatever pickletools and torch raise for bytes that make no sense
        raise UserError(f"{what} is damaged, or does not contain a table of tensors") from error
    if not all(np.isfinite(array).all() for array in tensors.values()):
        raise UserError(f"policy {path} has weights that are NaN or infinite")
    return tensors
