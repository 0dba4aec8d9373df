"""DYNAMIXEL servo chains: X, MX and P series on RS-485 or TTL, protocols 2.0 and 1.0."""
