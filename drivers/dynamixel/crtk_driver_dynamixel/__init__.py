"""DYNAMIXEL servo chains: X, MX, P, AX and RX series on RS-485 or TTL, protocols 2.0 and 1.0."""

from crtk_driver_dynamixel.plugin import PLUGIN

__all__ = ["PLUGIN"]
