"""Simulated CANopen drives (CiA 301, CiA 402), at the level of CAN frames."""
