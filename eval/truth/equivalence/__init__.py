"""The MuJoCo vehicle compared with the paper's model: `landing-eval equivalence`.

Each module measures one quantity and states it as claims: the measured value, the tolerance and its
derivation, with the text of `claims.toml`. `command` combines them. Modules from small to
large: `flying` (sequences of commands, and the tools), `levels`, `isolated`, `twin`, `motor`,
`closed_loop`, `check_cases`, `inconsistencies`.
"""
