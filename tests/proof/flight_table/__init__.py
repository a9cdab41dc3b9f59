"""`flight-table`: landings and faults through the whole chain, judged by what truly happened.

`chain` flies once, `table` the paper's starts, `faults` everything that can go wrong; `command` shows them.
"""
