"""How well policies do: `success`, `robustness`, `touchdown`, `mission`.

Policies x conditions x starts give flights (`flying` until the goal, `rest` until rest on the platform), a
table with a row for each. `study` flies them all and writes the results, `tables` makes tables and figures
of them. A study is a set of conditions: thrusts and effects (`changes`), `slopes`,
`vehicles`, `moving` platforms, and those of the commands themselves.
"""
