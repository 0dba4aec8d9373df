"""The fixtures of a session with a lab: ``lab`` and ``measure``; see `crtk_drivers.testing.lab_tests`."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

import pytest

from crtk_drivers.errors import CrtkError
from crtk_drivers.testing.lab_tests.devices import LabUnderTest
from crtk_drivers.testing.lab_tests.measured_figures import Figures
from crtk_drivers.testing.lab_tests.session import LabSession, TestUnderWay

SESSION: Final = pytest.StashKey[LabSession]()
"""Of a `pytest.Config`."""

UNDER_WAY: Final = pytest.StashKey[TestUnderWay]()
"""Of a `pytest.Item`."""


@pytest.fixture(scope="session")
def crtk_lab_session(pytestconfig: pytest.Config) -> Iterator[LabSession]:
    """The lab: alone with it from here on. It is left when the last test has ended, fixtures included."""
    session = pytestconfig.stash[SESSION]
    try:
        session.begin()
    except CrtkError as error:
        pytest.exit(str(error), pytest.ExitCode.USAGE_ERROR)
    with _ctrl_z_is_ctrl_c(session):
        yield session


@pytest.fixture
def lab(crtk_lab_session: LabSession) -> LabUnderTest:
    """The devices of the lab by name: ``lab.arm``."""
    return crtk_lab_session.lab_under_test()


@pytest.fixture
def measure(request: pytest.FixtureRequest, crtk_lab_session: LabSession) -> Figures:
    """Call it with what was measured: ``measure("lab.press.depth", 1.2, "mm", at_most=2.0)``."""
    test: TestUnderWay = request.node.stash[UNDER_WAY]
    return test.figures


@contextmanager
def _ctrl_z_is_ctrl_c(session: LabSession) -> Iterator[None]:
    """Within, Ctrl-Z is Ctrl-C where hardware may move: asleep, this process could stop nothing."""
    if not session.may_move_hardware:
        yield
        return

    def handler(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTSTP, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTSTP, before)
