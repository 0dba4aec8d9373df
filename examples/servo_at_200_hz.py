"""Stream joint positions at 200 Hz: all joints swing by two degrees.

python examples/servo_at_200_hz.py           # a simulated UR5e in this process
python examples/servo_at_200_hz.py /ur5      # whatever runs in that ROS 2 namespace
"""

import sys
import time

import numpy as np

import crtk_drivers
from crtk_drivers import client

RATE = 200.0
PERIOD = 2.0
AMPLITUDE = np.radians(2.0)


def open_arm() -> crtk_drivers.Arm:
    """Return the device that the command line asks for."""
    if len(sys.argv) > 1:
        return client.connect(sys.argv[1])
    return crtk_drivers.connect("ur", sim=True)


with open_arm() as arm:
    arm.enable()
    start = arm.setpoint_jp()
    begin = due = time.monotonic()
    errors = []
    while (elapsed := due - begin) < 2.0 * PERIOD:
        # One minus cosine: it begins and ends at rest.
        arm.servo_jp(start + AMPLITUDE * (1.0 - np.cos(2.0 * np.pi * elapsed / PERIOD)))
        errors.append(arm.measured_jp(age=0) - arm.setpoint_jp(age=0))
        due += 1.0 / RATE
        time.sleep(max(0.0, due - time.monotonic()))
    rate = len(errors) / (time.monotonic() - begin)
    lag = np.degrees(np.abs(errors).max())
    print(f"{rate:.1f} setpoints a second; the arm was at most {lag:.2f} degrees behind")
