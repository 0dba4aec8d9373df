"""Move an arm in joint space and in Cartesian space: absolute, relative, slower, in the tool's own axes.

python examples/move.py                # a simulated UR5e in this process
python examples/move.py /ur5           # whatever runs in that ROS 2 namespace, with up to six joints
"""

import sys

import numpy as np

import crtk_drivers
from crtk_drivers import client


def open_arm() -> crtk_drivers.Arm:
    """Return the device that the command line asks for."""
    if len(sys.argv) > 1:
        return client.connect(sys.argv[1])
    return crtk_drivers.connect("ur", sim=True)


with open_arm() as arm:
    arm.enable()
    start = arm.setpoint_jp()

    # Elbow and wrist bent too: a stretched arm is at a singularity, where no straight line begins.
    arm.move_jr(np.radians([15, -15, 30, 0, 30, 0])[: start.size]).wait()
    print(
        "joint 1 at", np.degrees(arm.setpoint_jp()[0] - start[0]).round(2), "degrees from the start"
    )

    if "move_cp" not in arm.crtk_commands:
        sys.exit(
            "no move_cp here: this device has no kinematics; the key `kinematics` gives it some"
        )

    pose = arm.setpoint_cp()
    arm.trajectory_j.set_ratio(0.5)  # half the speed from now on
    aside = pose.position + np.array([0.0, 0.05, 0.05])
    arm.move_cp(crtk_drivers.Pose(aside, pose.orientation)).wait()
    print("tool moved by", 1000 * (arm.setpoint_cp().position - pose.position).round(4), "mm")

    # 3 cm along the tool's own z axis: forward, as the tool sees it.
    before = arm.setpoint_cp()
    arm.body.move_cr([0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 1.0]).wait()
    way = np.linalg.norm(arm.setpoint_cp().position - before.position)
    print("tool went", round(1000 * float(way), 1), "mm forward")

    arm.trajectory_j.set_ratio(1.0)
    move = arm.move_jp(start)
    print("busy on the way back:", move.is_busy())
    move.wait()
    print("back at the start:", bool(np.allclose(arm.setpoint_jp(), start, atol=1e-3)))
