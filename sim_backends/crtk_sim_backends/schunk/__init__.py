"""Simulated SCHUNK devices: the grippers EGU, EGK and EZU, and the force sensor FTS with its Ethernet box."""
