"""PPO, its configuration, curriculum, callbacks and the `landing-train` command.

Public, for custom training with Stable-Baselines3 (examples/): `ppo_kwargs`, `scaled_observation`,
`AdaptiveCurriculum`, `CurriculumCallback`, `FastPPO`; and `TrainConfig` with `train`, which `landing-train`
calls.
"""

from inclined_landing.models.base.imports import at_first_use

__all__ = [
    "AdaptiveCurriculum",
    "CurriculumCallback",
    "FastPPO",
    "TrainConfig",
    "ppo_kwargs",
    "scaled_observation",
    "train",
]

_MODULES = {  # torch takes seconds to import
    "AdaptiveCurriculum": "curriculum",
    "CurriculumCallback": "callbacks",
    "FastPPO": "fast.ppo",
    "TrainConfig": "config",
    "ppo_kwargs": "ppo",
    "scaled_observation": "ppo",
    "train": "run",
}
__getattr__ = at_first_use(__name__, _MODULES)
