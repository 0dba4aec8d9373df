"""Let a hand feel what is not there: a floor of springs, rendered with servo_cf at 250 Hz.

The device is a gantry in memory that takes efforts. Its hand is made here, too: it pushes the handle down and
lets go. With a real haptic device leave the hand out.

python examples/render_forces.py
"""

import time

import numpy as np

import crtk_drivers

FLOOR = -0.02  # m
STIFFNESS = 400.0  # N/m
DAMPING = 5.0  # N·s/m
RATE = 250.0


def floor(height: float, velocity: float) -> float:
    """Return the force of the floor in N, upwards; it only pushes."""
    if height >= FLOOR:
        return 0.0
    return max(0.0, STIFFNESS * (FLOOR - height) - DAMPING * velocity)


def hand(elapsed: float) -> float:
    """Return the force of the hand in N: 10 N downwards for two seconds, then nothing."""
    return -10.0 if elapsed < 2.0 else 0.0


with crtk_drivers.connect("loopback", config={"rate": 500.0}) as handle:
    handle.enable()
    begin = due = time.monotonic()
    deepest = felt = 0.0
    while (elapsed := due - begin) < 3.0:
        height = handle.measured_cp(age=0).position[2]
        force = floor(height, handle.measured_cv(age=0).linear[2])
        handle.servo_cf([0.0, 0.0, force + hand(elapsed), 0.0, 0.0, 0.0])
        deepest, felt = min(deepest, height), max(felt, force)
        due += 1.0 / RATE
        time.sleep(max(0.0, due - time.monotonic()))
    depth = FLOOR - deepest
    print(f"the hand sank {1000 * depth:.1f} mm into the floor and felt {felt:.1f} N")
    resting = 10.0 / STIFFNESS
    print("as a spring has it:", bool(np.isclose(depth, resting, atol=0.2 * resting)))
    print("the floor pushed it out again:", bool(handle.measured_cp().position[2] > FLOOR - 0.002))
