"""The faults F1 to F20 by each driver with a rig: one table, run by the tests and by `bench.faults`.

`table` says what there is, `rigs` has what each driver meets a fault with, `activities` what it does
meanwhile, `procedures` how a cell is run and judged, `page` what is written about it.
"""
