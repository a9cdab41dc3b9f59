"""Is the MuJoCo vehicle the paper's model? `landing-eval equivalence` answers with numbers.

Each module measures one thing and states it as claims: what was measured, the tolerance and where the
tolerance comes from, in the words of `claims.toml`. `command` puts them together. Modules from small to
large: `flying` (sequences of commands, and the tools), `levels`, `isolated`, `twin`, `motor`, `convergence`,
`bandwidth`, `closed_loop`, `inconsistencies`.
"""
