"""`landing-eval robustness`: policies side by side under conditions that differ from what they know.

A condition set is one module: `changes` (thrust, effects of the library), `slopes`, `vehicles`, and
`eval.moving.report` for moving platforms. Each has `evaluate`, which flies all policies under all conditions
and returns the report as plain numbers, and `show`, which prints it. `figures` draws the reports, `words`
says what those of `changes` show, `entries` reads how policies are named.
"""
