"""The official CRTK Python client against the node.

Its code is not part of this project. `CRTK_PYTHON_CLIENT` names the folder that holds its package `crtk`
(``src`` in its repository); PyKDL must be importable too. The client runs in a process of its own, as
users run it.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from ros_rig import Rig

FOLDER = os.environ.get("CRTK_PYTHON_CLIENT", "")
pytestmark = pytest.mark.skipif(
    not FOLDER, reason="CRTK_PYTHON_CLIENT does not name the sources of the official client"
)

PREAMBLE = """
import sys
import numpy
import PyKDL
import crtk

class Arm:
    def __init__(self, ral):
        self.utils = crtk.utils(self, ral, 1.0)
        for name in sys.argv[2:]:
            getattr(self.utils, "add_" + name)()

ral = crtk.ral("official_client")
child = ral.create_child(sys.argv[1])
arm = Arm(child)
ral.check_connections(10.0)
ral.spin()
"""

MOVES = """
assert arm.enable(10.0)
goal = numpy.array([0.05, 0.02, 0.0, 0.1])
assert arm.move_jp(goal).wait(timeout=10.0)
assert numpy.allclose(arm.measured_jp(), goal, atol=5e-3), arm.measured_jp()
assert arm.move_jp(goal).wait(timeout=10.0), "a move that is there already"
frame = arm.measured_cp()
frame.p[2] += 0.04
assert arm.move_cp(frame).wait(timeout=10.0)
assert abs(arm.measured_cp().p[2] - 0.04) < 5e-3
assert arm.move_jp(numpy.array([1.0])).wait(timeout=10.0), "a refused move"
assert arm.move_jp(numpy.zeros(4)).wait(is_busy=True, timeout=10.0)
arm.hold()
assert arm.disable(10.0)
assert arm.move_jp(goal).wait(timeout=10.0), "a move while disabled"
"""

STREAM = """
import time
assert arm.enable(10.0)
for i in range(100):
    arm.servo_jp(numpy.array([0.0005 * i, 0.0, 0.0, 0.0]))
    time.sleep(0.01)
end = time.monotonic() + 10.0
while abs(arm.measured_jp(age=0.0)[0] - 0.0495) > 1e-3:
    assert time.monotonic() < end, arm.measured_jp()
frame = arm.forward_kinematics(numpy.array([0.1, 0.2, 0.3, 0.0]))
assert abs(frame.p[1] - 0.2) < 1e-12
assert arm.is_homed()
arm.state_command("pause")
assert arm.wait_for_operating_state("PAUSED", 10.0)
arm.state_command("resume")
assert arm.wait_for_operating_state("ENABLED", 10.0)
"""


@pytest.mark.parametrize(
    ("script", "names"),
    [
        (MOVES, "operating_state measured_js measured_cp move_jp move_cp hold"),
        (STREAM, "operating_state measured_js servo_jp forward_kinematics"),
    ],
    ids=["moves", "stream"],
)
def test_official_client(rig: Rig, script: str, names: str) -> None:
    path = os.pathsep.join([FOLDER, *filter(None, [os.environ.get("PYTHONPATH")])])
    program = f"{PREAMBLE}{script}\nral.shutdown()\n"
    result = subprocess.run(
        [sys.executable, "-c", program, rig.client.namespace, *names.split()],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert result.returncode == 0, result.stderr
