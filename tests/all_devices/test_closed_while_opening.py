"""A driver that is closed while it still connects: that is no fault of the device."""

from __future__ import annotations

import threading
from unittest.mock import patch

import pytest

from crtk_drivers.engine import Observer
from crtk_drivers.samples import Stamp
from crtk_drivers.state import OperatingState, Status
from rigs.waiting import LONG
from rigs.ways import WAYS, session_on


class Announced(Observer):
    """What is announced of a device: not how it was before, which is FAULT."""

    def __init__(self) -> None:
        self.states: list[OperatingState] = []

    def status_changed(self, status: Status, stamp: Stamp) -> None:
        self.states.append(status.state)


@pytest.mark.sweep(5)
@pytest.mark.parametrize(("name", "key", "way"), WAYS, ids=lambda part: part or "-")
def test_closing_while_connecting_is_no_fault(name: str, key: str, way: str) -> None:
    session, announced = session_on(name, key, way), Announced()
    device, begun = session.engine.device, threading.Event()
    session.engine.add_observer(announced)
    open_it = device.open

    def opens(deadline: float) -> None:
        begun.set()
        open_it(deadline)

    with patch.object(device, "open", opens):
        session.start()
        assert begun.wait(LONG)
        session.close(LONG)
    assert OperatingState.FAULT not in announced.states
    assert session.engine.status.state is OperatingState.DISABLED
