"""The unmodified urx library drives a simulated CB3 controller over its secondary port.

urx 0.11 knows the states of 3.0 to 3.4 alone, by their length. Its Cartesian calls do not work with
the math3d that it installs.
"""

from importlib.util import find_spec

import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_clients import last_json, output_of

pytestmark = [pytest.mark.slow, pytest.mark.skipif(find_spec("urx") is None, reason="needs urx")]

SESSION = """
import json, sys, urx
robot = urx.Robot(sys.argv[1])
try:
    start = robot.getj()
    goal = [start[0] + 0.3, *start[1:]]
    robot.movej(goal, acc=3, vel=2)
    reached = robot.getj()
    robot.speedj([0.2, 0, 0, 0, 0, 0], 2, 0.3)
    robot.stopj(5)
    robot.secmon.wait()
    print(json.dumps({
        "start": start,
        "goal": goal,
        "reached": reached,
        "running": robot.is_running(),
        "modes": robot.secmon.get_all_data()["RobotModeData"],
        "offset": robot.secmon.get_cartesian_info().get("tcpOffsetX"),
    }))
finally:
    robot.close()
"""


@pytest.mark.parametrize(("version", "offset"), [("3.0", None), ("3.4", 0.0)])
def test_urx_sees_the_state_and_moves_joints(version, offset):
    with SIM.spawn(model="ur5", version=version) as sim:
        seen = last_json(output_of(SESSION, sim.host))
    assert seen["start"] == pytest.approx([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])
    assert seen["reached"] == pytest.approx(seen["goal"], abs=0.06)  # urx calls 20 % away reached
    assert seen["running"]
    assert seen["modes"]["robotMode"] == 7
    assert seen["offset"] == offset
