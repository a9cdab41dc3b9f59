"""The report after a training."""

import dataclasses
import json

import pytest

from inclined_landing.envs.policy import load_policy
from inclined_landing.eval import after_training


@pytest.mark.parametrize("other", [False, True])
def test_the_best_policy_is_flown_only_where_it_is_not_the_final_one(tmp_path, monkeypatch, other):
    """With the network of final.zip it has the same numbers, of the thrust as it is."""
    final = load_policy("landing-nominal")
    changed = [*final.biases[:-1], final.biases[-1] + 1e-3]
    best = dataclasses.replace(final, biases=tuple(changed)) if other else load_policy("landing-nominal")
    asked = []

    def evaluate(policy, *, thrust_scales=(1.0,)):
        asked.append(policy)
        of = {"strict": len(asked), "success": 0}
        return {"conditions": [{"thrust_scale": x, "grid": of, "entry": None} for x in thrust_scales]}

    monkeypatch.setattr(after_training.success, "evaluate", evaluate)
    (tmp_path / "best.zip").touch()
    policies, metrics = {"final.zip": final, "best.zip": best}, {}
    after_training._success(tmp_path, metrics, lambda path: policies[path.name])
    assert len(asked) == (2 if other else 1) and asked[0] is final
    (shown,) = metrics["success"]["best"]
    assert shown["thrust_scale"] == 1.0 and shown["strict"] == (2 if other else 1)
    assert json.loads((tmp_path / "success.json").read_text())["conditions"][0]["grid"]["strict"] == 1
