"""The frozen benchmark of landings on moving platforms, `landing-eval robustness --over moving`.

scenario: the scenarios of `scenarios.toml`, and how they are drawn. controllers: what is scored; planner: the
one without learning.
"""
