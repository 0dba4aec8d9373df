"""Devices around a device: with kinematics, in another base frame."""
