"""What is told of the operating state, and that nobody waits for who is told."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator

import pytest
from typing_extensions import override

from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.board import Observer, StatusBoard
from crtk_drivers.status.health import HealthRecorder
from crtk_drivers.testing.clock import FakeClock
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig

LOCKED = 5.0
"""Seconds in which another thread gets a lock that is free."""


class Watching(logging.Handler):
    """Logs slowly: it waits until another thread has had the lock of the board.

    Attributes:
        told: what was logged, and whether another thread could have the lock meanwhile.
    """

    def __init__(self) -> None:
        super().__init__(logging.DEBUG)
        self.told: dict[str, bool] = {}
        self.board: StatusBoard | None = None

    @override
    def emit(self, record: logging.LogRecord) -> None:
        assert self.board is not None
        found: list[bool] = []
        thread = threading.Thread(target=_try, args=(self.board, found))
        thread.start()
        thread.join()
        self.told[record.getMessage()] = found[0]


def _try(board: StatusBoard, found: list[bool]) -> None:
    is_taken = board.lock.acquire(timeout=LOCKED)
    found.append(is_taken)
    if is_taken:
        board.lock.release()


@pytest.fixture
def watching() -> Iterator[Watching]:
    logger, handler = logging.getLogger("crtk_drivers"), Watching()
    before = logger.level
    logger.setLevel(logging.DEBUG)
    logger.addHandler(handler)
    yield handler
    logger.removeHandler(handler)
    logger.setLevel(before)


@pytest.fixture
def board(watching: Watching) -> StatusBoard:
    clock = FakeClock()
    watching.board = StatusBoard(Status(), "arm", HealthRecorder(100.0, 0.1), clock)
    return watching.board


class Failing(Observer):
    """Has a bug."""

    @override
    def latched(self, name: str) -> None:
        raise ZeroDivisionError


TOLD: dict[str, Callable[[StatusBoard], object]] = {
    "arm: FAULT: broken": lambda board: board.update(OperatingState.FAULT, "broken"),
    "arm: late": lambda board: board.warned("late"),
    "arm: an observer failed": lambda board: board.latched("goal_js"),
}


@pytest.mark.parametrize("text", TOLD)
def test_who_logs_slowly_holds_up_nobody_who_tells(
    text: str, board: StatusBoard, watching: Watching
) -> None:
    board.add(Failing())
    with board.lock:
        TOLD[text](board)
        assert not watching.told
    assert watching.told == {text: True}
    board.lock.afterwards(lambda: watching.told.clear())
    assert not watching.told


def test_nor_does_a_front_that_logs(watching: Watching) -> None:
    with LocalDevice(Session(PLUGIN, LoopbackConfig())) as device:  # not started: nobody else tells
        board = watching.board = device.engine._board
        board.warned("late")
        refusal = CommandRefused("servo_jp", Reason.TOO_OLD, "late", where="arm")
        board.refused(refusal)
        assert str(refusal) in watching.told
        assert all(watching.told.values())
