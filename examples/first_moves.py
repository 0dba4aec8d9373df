"""Enable an arm, move it, and read what it does. No ROS.

python examples/first_moves.py                    # a simulated UR5e
python examples/first_moves.py 192.168.1.10       # a real one: clear the space around it first
"""

import sys

import numpy as np

import crtk_drivers

HOST = sys.argv[1] if len(sys.argv) > 1 else ""

with crtk_drivers.connect("ur", sim=not HOST, host=HOST) as arm:
    print("connected:", arm.operating_state().state)
    arm.enable()

    start = arm.setpoint_jp()
    arm.move_jp(start + np.radians([10, 0, 0, 0, 0, 0])).wait()
    print("base turned by", np.degrees(arm.measured_jp() - start).round(2)[0], "degrees")

    pose = arm.setpoint_cp()
    lifted = crtk_drivers.Pose(pose.position + np.array([0.0, 0.0, 0.05]), pose.orientation)
    arm.move_cp(lifted).wait()
    print("tool lifted by", (arm.measured_cp().position - pose.position).round(4)[2], "m")

    arm.move_jp(start).wait()
    print("force at the tool:", arm.measured_cf().force.round(1), "N")
