"""`flight-table`: landings and faults through the whole chain, judged by what truly happened.

`chain` flies once, `faults` everything that can go wrong, `command` the paper's starts; it shows both.
"""
