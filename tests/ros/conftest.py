"""Fixtures: a device on ROS 2 with a client.

They live as long as a test file: ROS needs up to three seconds until two ends have found each other. Each
test gets the device back at zero, connected and DISABLED.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest

from crtk_drivers.cli import main
from crtk_drivers.client import move_handle, survey
from crtk_drivers.client.teleop import loop as teleoperation
from crtk_drivers.front import base
from rigs.waiting import LONG

if TYPE_CHECKING:
    from rigs.loopback_node import Rig

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="session", autouse=True)
def patient_client() -> Iterator[None]:
    """Let a client wait longer for what it waits for unless a call says otherwise."""
    with (
        patch.object(base, "DEFAULT_WAIT", LONG),
        patch.object(base, "QUERY_TIMEOUT", LONG),
        patch.object(move_handle, "ACCEPT_TIMEOUT", LONG),
        patch.object(survey, "STATUS_TIME", LONG),
        patch.object(survey, "REPORT_TIME", LONG),
        patch.object(teleoperation, "STAND_TIMEOUT", LONG),
    ):
        yield


@pytest.fixture(scope="module")
def shared_rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    from rigs.loopback_node import rig_of  # it needs rclpy, which the tests beside this file do not

    with rig_of(f"/{request.path.stem}") as rig:
        yield rig


@pytest.fixture
def rig(shared_rig: Rig) -> Rig:
    shared_rig.reset()
    return shared_rig


@pytest.fixture
def run_far(capfd: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """Run the command line in this process: its exit code, and what it printed."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level

    def run(*arguments: str) -> tuple[int, str, str]:
        code = main(arguments)
        shown = capfd.readouterr()
        assert "Traceback" not in shown.err
        return code, shown.out, shown.err

    yield run
    root.handlers[:] = handlers
    root.setLevel(level)
    logging.captureWarnings(False)
