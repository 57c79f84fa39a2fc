"""Vector Product Format (MIL-STD-2407): tables, directories and features, without any store.

`vpfx.vpf.table` reads and writes single tables.
"""
