"""Lead one device with another, and feel what the follower touches.

The follower goes where the leader is led (`servo_cp`), the leader is pushed by what the follower's tool
feels (`servo_cf`). Here the leader is a gantry in memory and the follower a simulated UR5e; the hand that
leads and the table that is touched are made in this script.

python examples/teleoperate.py                     # both simulated, in this process
python examples/teleoperate.py /leader /follower   # two ROS 2 namespaces, with a real hand and a real table
"""

import sys
import time

import numpy as np

import crtk_drivers
from crtk_drivers import client
from crtk_drivers.plugins import RunningSim
from crtk_drivers.samples import Vector

RATE = 100.0
SECONDS = 6.0
SCALE = 0.5  # of the leader's motion
REFLECTED = 0.5  # of the follower's force
TABLE = -0.02  # m below where the tool begins
STIFFNESS = 500.0  # N/m, of the table


class Hand:
    """Pulls the leader's handle like a spring: down by 8 cm, and up again."""

    def force(self, elapsed: float, position: Vector) -> Vector:
        """Return what it pulls with, in N."""
        wanted = np.array([0.0, 0.0, -0.04 * (1.0 - np.cos(2.0 * np.pi * elapsed / SECONDS))])
        pull: Vector = 100.0 * (wanted - position)
        return pull


class Table:
    """Pushes against the tool of a simulated arm."""

    def __init__(self, sim: RunningSim, height: float) -> None:
        self._sim = sim
        self._height = height
        self.force = 0.0

    def touch(self, position: Vector) -> None:
        """Push as hard as the tool is deep in the table."""
        force = max(0.0, STIFFNESS * (self._height - position[2]))
        if force != self.force:
            self._sim.control.inject("external_force", wrench=[0.0, 0.0, force, 0.0, 0.0, 0.0])
            self.force = force


def teleoperate(
    leader: crtk_drivers.HapticDevice,
    follower: crtk_drivers.Arm,
    hand: Hand | None = None,
    table: Table | None = None,
) -> None:
    """Couple the two for some seconds."""
    home, start = leader.measured_cp().position, follower.setpoint_cp()
    quiet = follower.measured_cf().force  # what the sensor says when nothing is touched
    begin = due = time.monotonic()
    felt, deepest, farthest = 0.0, 0.0, 0.0
    while (elapsed := due - begin) < SECONDS:
        led = leader.measured_cp(age=0).position - home
        follower.servo_cp([*(start.position + SCALE * led), *start.orientation])
        tool = follower.measured_cp(age=0).position
        force = REFLECTED * (follower.measured_cf(age=0).force - quiet)
        push = np.zeros(3) if hand is None else hand.force(elapsed, led)
        leader.servo_cf([*(force + push), 0.0, 0.0, 0.0])
        if table is not None:
            table.touch(tool)
        felt = max(felt, float(np.linalg.norm(force)))
        deepest, farthest = min(deepest, tool[2] - start.position[2]), min(farthest, led[2])
        due += 1.0 / RATE
        time.sleep(max(0.0, due - time.monotonic()))
    print(
        f"the hand was led {-1000 * farthest:.0f} mm down, the tool went {-1000 * deepest:.0f} mm down"
    )
    print(f"the hand felt up to {felt:.1f} N")


if len(sys.argv) > 2:
    with client.connect(sys.argv[1]) as hand, client.connect(sys.argv[2]) as arm:
        hand.enable()
        arm.enable()
        teleoperate(hand, arm)
else:
    with (
        crtk_drivers.connect("loopback", config={"rate": 500.0}) as gantry,
        crtk_drivers.connect("ur", sim=True) as ur,
    ):
        assert ur.sim is not None  # there is one because of sim=True
        gantry.enable()
        ur.enable()
        table = Table(ur.sim, ur.setpoint_cp().position[2] + TABLE)
        teleoperate(gantry, ur, Hand(), table)
