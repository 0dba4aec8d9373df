"""Follow a source that gives a joint position only 20 times a second, smoothly.

A camera or a network gives goals at 20 Hz, late and unevenly. `interpolate_jp` makes a motion of them at the
device's own rate, one input period later, with position and velocity continuous; `servo_jp` would step.

python examples/interpolate_from_20_hz.py           # a simulated UR5e in this process
python examples/interpolate_from_20_hz.py /ur5      # whatever runs in that ROS 2 namespace
"""

import random
import sys
import time

import numpy as np

import crtk_drivers
from crtk_drivers import client

RATE = 20.0
SECONDS = 4.0


def open_arm() -> crtk_drivers.Arm:
    """Return the device that the command line asks for."""
    if len(sys.argv) > 1:
        return client.connect(sys.argv[1])
    return crtk_drivers.connect("ur", sim=True)


with open_arm() as arm:
    arm.enable()
    start = arm.setpoint_jp()
    begin = due = time.monotonic()
    fastest = steps = 0.0
    while (elapsed := due - begin) < SECONDS:
        arm.interpolate_jp(start + 0.1 * (1.0 - np.cos(np.pi * elapsed)))
        due += 1.0 / RATE
        while time.monotonic() < due + random.uniform(0.0, 0.2) / RATE:
            before = arm.setpoint_js(age=0)
            time.sleep(0.004)
            after = arm.setpoint_js(age=0)
            fastest = max(fastest, float(np.abs(after.velocity).max(initial=0.0)))
            steps = max(steps, float(np.abs(after.position - before.position).max()))
    print(
        f"20 goals a second became steps of at most {1000 * steps:.1f} mrad; fastest {fastest:.2f} rad/s"
    )
    arm.hold()
