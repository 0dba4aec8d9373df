"""Stream tool poses at 250 Hz: a circle of 3 cm about the present position. No ROS.

python examples/stream_a_circle.py                # a simulated UR5e
"""

import time

import numpy as np

import crtk_drivers

RADIUS = 0.03
PERIOD = 4.0
RATE = 250.0

with crtk_drivers.connect("ur", sim=True) as arm:
    arm.enable()
    centre = arm.setpoint_cp()
    begin = due = time.monotonic()
    worst = 0.0
    while (elapsed := due - begin) < PERIOD:
        angle = 2.0 * np.pi * elapsed / PERIOD
        # Starts and ends at rest at the centre: the radius grows and shrinks with the angle.
        radius = RADIUS * np.sin(angle / 2.0) ** 2
        offset = radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        arm.servo_cp(crtk_drivers.Pose(centre.position + offset, centre.orientation))
        lag = arm.measured_cp(age=0).position - arm.setpoint_cp(age=0).position
        worst = max(worst, float(np.linalg.norm(lag)))
        due += 1.0 / RATE
        time.sleep(max(0.0, due - time.monotonic()))
    print(f"the tool was at most {1000 * worst:.1f} mm behind its setpoint")
