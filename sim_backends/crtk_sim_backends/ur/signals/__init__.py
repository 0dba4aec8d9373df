"""Signals, registers and variables, and the units that share them."""
