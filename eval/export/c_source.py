"""The C export: landing_policy.c and .h, with a self test."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.eval.base.page import environment
from inclined_landing.eval.export.vectors import Vectors
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown

LARGEST = 512 * 1024  # bytes of constants: half of the flash of an STM32F405, which the firmware shares
SMALL = 100_000  # bytes that are no burden beside the firmware
_PER_LINE = 6


def write(folder: Path, policy: Policy, contract: dict, vectors: Vectors) -> None:
    """Write the C source into `folder`.

    Raises UserError when the constants would not fit next to the firmware.
    """
    size = 4 * contract["cost"]["constants"]
    if size > LARGEST:
        raise UserError(
            f"policy {policy.name} has {size} bytes of constants; the C export takes at most {LARGEST}, half "
            "of the flash of a Crazyflie"
        )
    content = _template_values(contract, policy, vectors)
    templates = environment(__package__, keep_trailing_newline=True)
    (folder / "src").mkdir()
    for name in ("src/landing_policy.h", "src/landing_policy.c", "check.c"):
        template = templates.get_template(f"c/{Path(name).name}.j2")
        storage.write_text(folder / name, template.render(content))


def _template_values(contract: dict, policy: Policy, vectors: Vectors) -> dict:
    history, o = contract["input"]["history"]["steps"], len(contract["observation"])
    inputs, layers = contract["input"]["size"], contract["network"]["layers"]
    widest, a, task = max(inputs, *layers), layers[-1], contract["task"]["name"]
    stack = 4 * (2 * widest + (inputs + a) * (history > 0))
    stack += 4 * (1 + (inputs - o) * (history > 0) + a)  # of the self test
    return {
        **contract,
        "about": f"Policy {_comment_text(contract['policy']['name'])} of the task {task}, exported by "
        f"inclined-landing {contract['versions']['inclined-landing']}.",
        "number": number,
        "stack": stack,
        "observation_names": [_comment_text(entry["name"]) for entry in contract["observation"]],
        "widest": widest,
        "blocks": _blocks(policy),
        "limit": number(0.0 if math.isinf(policy.limit) else policy.limit),
        "bound": number(0.0 if math.isinf(policy.bound) else policy.bound),
        "vectors": len(vectors.observations),
        "vector_observations": _format_rows(vectors.observations),
        "vector_actions": _format_rows(vectors.actions),
    }


def _blocks(policy: Policy) -> list[tuple[str, str]]:
    """Return the constants in the order of the C source, in blocks with a comment."""
    blocks = [("centres of the inputs", policy.centre), ("scales of the inputs", policy.scale)]
    for k, (weight, bias) in enumerate(zip(policy.weights, policy.biases), start=1):
        inputs, outputs = weight.shape
        blocks.append((f"layer {k}, {outputs} outputs: biases", bias))
        blocks.append((f"layer {k}, {inputs} inputs: weights, one row for each input", weight.ravel()))
    return [(comment, _format_numbers(numbers)) for comment, numbers in blocks]


def _comment_text(name: str) -> str:
    """Return a name escaped for a C comment."""
    # Without "?", there are no trigraphs, one of which is a backslash that continues the line.
    return shown(name).replace("?", "").replace("*/", "* /").replace("/*", "/ *")


def number(value: float) -> str:
    """Return a float as a C literal, in the fewest digits that reproduce it."""
    text = str(np.float32(value))
    return f"{text}f"


def _format_numbers(values: Iterable[float]) -> str:
    """Return numbers as C literals, a few to a line."""
    texts = [number(value) for value in values]
    lines = (", ".join(texts[k : k + _PER_LINE]) for k in range(0, len(texts), _PER_LINE))
    return "    " + ",\n    ".join(lines)


def _format_rows(rows: np.ndarray) -> str:
    """Return rows (m, k) as C initialisers, one to a line."""
    return ",\n".join("        {" + ", ".join(map(number, row)) + "}" for row in rows)
