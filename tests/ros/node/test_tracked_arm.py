"""A simulated arm and a simulated tracker that sees its marker, calibrated live against the lab file."""

from __future__ import annotations

import re
import subprocess
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from crtk_drivers.client import connect
from crtk_drivers.config.settings import BaseConfig, PoseConfig
from crtk_drivers.geometry.frames import product, relative
from crtk_drivers.labs.calibration.measured_files import POINT, write_table
from crtk_drivers.labs.calibration.stillness import distance
from crtk_drivers.samples import Pose
from rigs.lab_up import up
from rigs.measured_poses import pose
from rigs.programs import COMMAND, Program, Start

pytestmark = [pytest.mark.ros, pytest.mark.timeout(400)]

LONG = 120.0
STANDS = pose((-2.0, -0.1, 0.4), (0.0, -np.pi / 2.0, 0.0))
MOUNTING = pose((0.02, -0.05, 0.11), (0.5, 1.2, -0.7))
PAIRS, POINTS = 8, 4
SLOW = 0.15
"""Share of the speed of moves: an arm whose simulator gets no time falls behind by less."""
LAB = f"""
[devices.arm]
plugin = "ur"
namespace = "/tracked/arm"
settings = {{ model = "ur5e", sample_timeout = 3.0, watchdog_frequency = 2.0 }}

[devices.polaris]
plugin = "ndi"
namespace = "/tracked/polaris"
settings.tools = [{{ name = "marker", part_number = "SIM-MARKER" }}]
stands = {{ position = {STANDS.position.tolist()}, orientation = {STANDS.orientation.tolist()} }}
[devices.polaris.markers.marker]
on = "arm"
mounting = {{ position = {MOUNTING.position.tolist()}, orientation = {MOUNTING.orientation.tolist()} }}
"""


class Calibrating:
    """A `crtk-driver calibrate` that runs, and what it has told."""

    def __init__(self, process: Program) -> None:
        self._process = process

    def taken(self, number: int) -> None:
        """Wait until so many places are taken."""
        assert self._process.stderr is not None
        lines = []
        for line in self._process.stderr:
            lines.append(line)
            if re.search(rf"\b{number} of \d+ taken", line):
                return
        raise AssertionError(f"it has ended: {lines}")

    def told(self) -> dict[str, Any]:
        """Wait for its end, and return what it printed as configuration."""
        printed, errors = self._process.communicate(timeout=LONG)
        assert self._process.returncode == 0, errors
        return tomllib.loads(printed[printed.index("# ") :])


@contextmanager
def calibrating(start: Start, *arguments: str) -> Iterator[Calibrating]:
    pipe = subprocess.PIPE
    with start(COMMAND, "calibrate", *arguments, stdout=pipe, stderr=pipe) as process:
        try:
            yield Calibrating(process)
        finally:
            process.kill()


def places(home: np.ndarray) -> list[np.ndarray]:
    """Return joints that turn the tool about all axes, and move it by some centimetres."""
    random = np.random.default_rng(3)
    far = np.array((0.1, 0.1, 0.1, 0.5, 0.5, 0.5))
    return [home + far * random.uniform(-1.0, 1.0, 6) for _ in range(PAIRS)]


def assert_near(found: Pose, true: Pose, metres: float) -> None:
    moved, turned = distance(found, true)
    assert moved < metres, f"{1e3 * moved:.3f} mm"
    assert turned < 1e-3, f"{np.degrees(turned):.4f} deg"


@pytest.mark.slow  # tests/ndi/wire/test_on_an_arm.py has what is seen, tests/cli what is found
def test_hand_eye_and_a_model_are_found_where_the_lab_file_has_them(
    start: Start, tmp_path: Path
) -> None:
    model = tmp_path / "model.csv"
    with up(start, tmp_path, LAB, "--sim") as lab:
        lab.until("polaris: measures")
        with (
            connect("/tracked/arm", timeout=LONG) as arm,
            connect("/tracked/polaris", timeout=LONG) as tracker,
        ):
            arm.enable(LONG)
            tracker.enable(LONG)
            arm.trajectory_j.set_ratio(SLOW)
            goals = places(arm.measured_js(wait=LONG).position)
            marked = [product(arm.forward_kinematics(goal), MOUNTING) for goal in goals]
            write_table(model, {"": np.array([at.position for at in marked[:POINTS]])}, POINT)
            arm.move_jp(goals[0]).wait(LONG)
            with (
                calibrating(
                    start,
                    "hand-eye",
                    "/tracked/arm",
                    "/tracked/polaris/marker",
                    "--pairs",
                    f"{PAIRS}",
                ) as eye,
                calibrating(
                    start, "register", "/tracked/polaris/marker", "--model", str(model)
                ) as bone,
            ):
                for number, goal in enumerate(goals, 1):
                    arm.move_jp(goal).wait(LONG)
                    eye.taken(number)
                    if number <= POINTS:
                        bone.taken(number)
                found, registered = eye.told(), bone.told()
        assert lab.end() == 0
    base = BaseConfig.model_validate(found["base"])
    marker = PoseConfig.model_validate(found["kinematics"]["tool"])
    assert base.frame_id == "tracked/arm/base"
    assert_near(base.pose, STANDS, 1e-3)
    assert_near(marker.pose, MOUNTING, 1e-3)
    in_tracker = PoseConfig.model_validate(registered["pose"]).pose
    for at in marked[:POINTS]:
        seen = product(in_tracker, at)
        assert np.allclose(seen.position, relative(STANDS, at).position, atol=1e-3)
