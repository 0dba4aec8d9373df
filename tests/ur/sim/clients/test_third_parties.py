"""Clients from PyPI that nobody here wrote, unmodified, each in a process of its own.

`urinterface` commands over the secondary port and the dashboard, and records by Universal Robots' own RTDE
client library of 2020, which it brings along as a package of its own; `universal-robots-clients` asks the
dashboard and exchanges registers through ur-rtde.
"""

from __future__ import annotations

import csv
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_clients import last_json, output_of

pytestmark = pytest.mark.slow

needs_urinterface = pytest.mark.skipif(find_spec("urinterface") is None, reason="needs urinterface")
needs_clients = pytest.mark.skipif(
    find_spec("universal_robots_clients") is None, reason="needs universal-robots-clients"
)
CONTROLLERS = pytest.mark.parametrize(
    ("model", "version"), [("ur5e", "5.12.4"), ("ur5", "3.15.8"), ("ur10e", "5.23.0")]
)

RECIPE = """<?xml version="1.0"?>
<rtde_config>
  <recipe key="out">
    <field name="timestamp" type="DOUBLE"/>
    <field name="actual_q" type="VECTOR6D"/>
    <field name="actual_digital_input_bits" type="UINT64"/>
    <field name="joint_mode" type="VECTOR6INT32"/>
    <field name="safety_mode" type="INT32"/>
  </recipe>
</rtde_config>
"""

MOVES = """
import json, sys
import numpy as np
from third_party.rtde import rtde
from urinterface.robot_connection import RobotConnection

host, recipe, output = sys.argv[1:]
arm = RobotConnection(host)
start = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])
arm.start_recording(recipe, output, frequency=125)
arm.movej(start + 0.2, v=1.5, a=4.0)
arm.sleep(0.1)
arm.movel(start, v=1.0, a=4.0)
arm.zero_ftsensor()
arm.stop_recording()
state = rtde.RTDE(host)
state.connect()
print(json.dumps({"version": state.get_controller_version(), "start": start.tolist()}))
state.disconnect()
"""

RECORD = """
import runpy, sys
sys.argv = ["record.py", *sys.argv[1:]]
runpy.run_module("third_party.rtde.record", run_name="__main__")
"""

CLIENTS = """
import json, sys, time
from universal_robots_clients import dashboard_client as dashboard, rtde_client as rtde

host = sys.argv[1]
told = {"loaded": dashboard.load_program(host, "wait.urp"), "played": dashboard.play_program(host)}
deadline = time.monotonic() + 20.0
while "PLAYING" not in dashboard.get_program_state(host):
    assert time.monotonic() < deadline
told["paused"] = dashboard.pause_program(host)
told["stopped"] = dashboard.stop_program(host)
told["nonsense"] = dashboard.send_command(host, "make coffee")

arm = rtde.connect(host)
told["joints"] = rtde.read_actual_joint_positions(arm)
told["mode"] = rtde.read_robot_mode(arm)
told["safety"] = rtde.read_safety_mode(arm)
rtde.write_speed_slider_percent(50.0, arm)
while rtde.read_speed_slider_percent(arm) != 50.0:
    assert time.monotonic() < deadline
rtde.write_tool_digital_output(1, True, arm)
while not rtde.read_tool_digital_output(1, arm):
    assert time.monotonic() < deadline
rtde.write_input_int_register(42, -7, arm)
rtde.write_input_double_register(42, 0.25, arm)
rtde.disconnect(arm)
print(json.dumps(told))
"""


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a recording of UR's library."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file, delimiter=" "))


@needs_urinterface
@CONTROLLERS
def test_urinterface_moves_and_records(model: str, version: str, tmp_path: Path) -> None:
    recipe, output = tmp_path / "recipe.xml", tmp_path / "moves.csv"
    recipe.write_text(RECIPE)
    with SIM.spawn(model=model, version=version) as sim:
        told = last_json(output_of(MOVES, sim.host, str(recipe), str(output)))
    assert told["version"][:2] == [int(part) for part in version.split(".")[:2]]
    rows = rows_of(output)
    turned = [float(row["actual_q_0"]) - told["start"][0] for row in rows]
    assert turned[0] == pytest.approx(0.0, abs=1e-3)
    assert max(turned) == pytest.approx(0.2, abs=1e-3)
    assert turned[-1] == pytest.approx(0.0, abs=1e-3)
    assert {row["safety_mode"] for row in rows} == {"1"}


@needs_urinterface
@CONTROLLERS
def test_record_of_urs_library(model: str, version: str, tmp_path: Path) -> None:
    recipe, output = tmp_path / "recipe.xml", tmp_path / "data.csv"
    recipe.write_text(RECIPE)
    options = ["--config", str(recipe), "--output", str(output), "--samples", "100"]
    with SIM.spawn(model=model, version=version) as sim:
        output_of(RECORD, "--host", sim.host, *options)
    stamps = [float(row["timestamp"]) for row in rows_of(output)]
    assert len(stamps) >= 99
    steps = [(after - before) / 0.008 for before, after in pairwise(stamps)]
    assert steps == pytest.approx([round(step) for step in steps], abs=1e-3)
    assert min(steps) > 0.9


@needs_clients
def test_universal_robots_clients(tmp_path: Path) -> None:
    (tmp_path / "wait.urp").write_bytes(b"")
    (tmp_path / "wait.script").write_text("def wait():\n  sleep(100.0)\nend\n")
    with SIM.spawn(version="5.12.4", programs=str(tmp_path)) as sim:
        told = last_json(output_of(CLIENTS, sim.host))
        found = sim.control.outputs(
            "actual_digital_output_bits", "target_speed_fraction", "input_int_register_42"
        )
    assert found["actual_digital_output_bits"] == 1 << 17
    assert found["target_speed_fraction"] == 0.5
    assert found["input_int_register_42"] == -7
    assert told["loaded"].startswith("Loading program: ")
    assert told["played"] == "Starting program"
    assert told["paused"] == "Pausing program"
    assert told["stopped"] == "Stopped"
    assert told["nonsense"].startswith("could not understand")
    assert told["joints"] == pytest.approx([0.0, -1.57, 1.57, -1.57, -1.57, 0.0], abs=1e-3)
    assert (told["mode"], told["safety"]) == (7, 1)
