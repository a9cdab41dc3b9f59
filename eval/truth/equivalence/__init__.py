"""Is the MuJoCo vehicle the paper's model? `landing-eval validate equivalence` answers with numbers.

Each module measures one thing and states it as claims (`base/claims.py`): what was measured, the tolerance
and where the tolerance comes from, in the words of `claims.toml`. `report.py` puts them together. Modules
from small to large: `sequences`, `flying` (the common tools), `levels`, `isolated`, `twin`, `motor`,
`convergence`, `bandwidth`, `closed_loop`, `inconsistencies`.
"""
