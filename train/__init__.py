"""PPO, its configuration, curriculum, callbacks and the `landing-train` command.

Public, for custom training with Stable-Baselines3 (examples/): `ppo_kwargs`, `scaled_observation`,
`AdaptiveCurriculum`, `CurriculumCallback`, `FastPPO`; and `TrainConfig` with `train`, which `landing-train`
calls.
"""

from importlib import import_module

__all__ = [
    "AdaptiveCurriculum",
    "CurriculumCallback",
    "FastPPO",
    "TrainConfig",
    "ppo_kwargs",
    "scaled_observation",
    "train",
]

_AT_FIRST_USE = {  # torch takes seconds to import
    "AdaptiveCurriculum": "curriculum",
    "CurriculumCallback": "callbacks",
    "FastPPO": "fast.ppo",
    "TrainConfig": "config",
    "ppo_kwargs": "ppo",
    "scaled_observation": "ppo",
    "train": "run",
}


def __getattr__(name: str):
    if name not in _AT_FIRST_USE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_AT_FIRST_USE[name]}"), name)
