"""A gripper as a device, with a hand that a test speaks for: services that a stop crosses, and the end."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest
from typing_extensions import override

from crtk_drivers.device import Answer, Capabilities, JointLimits, Mode, Service
from crtk_drivers.errors import CommandRefused, PluginError
from crtk_drivers.kit.gripping import (
    Doing,
    Fault,
    GripperDevice,
    Hand,
    HandService,
    Measured,
    OnClose,
    When,
)
from crtk_drivers.samples import Flag, Stamp

LIMITS = JointLimits(0.0, 0.1, 0.1, 1.0, 10.0, 0.0)


class Spoken(Hand):
    """It takes each order at once, unless it is `deaf`; `sent` is what it was told."""

    capabilities = Capabilities(measured=(), rate=100.0)
    where = "a test"
    fault: Fault | None = None

    def __init__(self) -> None:
        self.sent: list[str] = []
        self.waiting = ""
        self.deaf = False
        self.now = Doing.UNKNOWN

    @property
    @override
    def is_open(self) -> bool:
        return self.now is not Doing.UNKNOWN

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self.now = Doing.HOLDS

    @override
    def close(self, *, moves: bool) -> None:
        self.sent.append(f"closed {moves=}")
        self.now = Doing.UNKNOWN

    @override
    def exchange(self, deadline: float) -> Measured | None:
        if self.deaf:
            return None
        if self.waiting:
            self.sent.append(self.waiting)
            self.waiting = ""
        return Measured(Stamp.now())

    @override
    def order(self, mode: Mode, value: float, ratio: float) -> str:
        return f"to {value}"

    @override
    def go(self, order: Any, *, at_once: bool) -> None:
        self.waiting = order

    @override
    def halt(self, *, aside: bool) -> None:
        self.waiting = "stop" if self.waiting or not self.rests else ""

    @override
    def let_go(self) -> None:
        self.waiting = "let go"

    @property
    @override
    def is_told(self) -> bool:
        return not self.waiting

    @property
    @override
    def doing(self) -> Doing:
        return self.now

    @property
    @override
    def services(self) -> Mapping[str, HandService]:
        return {
            "release": HandService("in two steps", self._release),
            "activate": HandService("in two steps", self._release, When.NOT_ENABLED),
        }

    def _release(self) -> Answer:
        for step in ("loosen", "open"):
            self.waiting = step
            yield
        return "released"


def enabled(hand: Spoken, on_close: OnClose = "hold") -> GripperDevice:
    device = GripperDevice(hand, "a test", on_close)
    device.open(time.monotonic() + 1.0)
    for _ in device.enable():
        device.read(time.monotonic())
    return device


@pytest.fixture
def hand() -> Spoken:
    return Spoken()


class Plain(Spoken):
    """Its service is one of a device, which does not say when it may be asked for."""

    @property
    @override
    def services(self) -> Mapping[str, Any]:
        return {"release": Service("in two steps", self._release)}


def test_a_hand_with_a_plain_service_is_refused() -> None:
    wrong = r"service 'release' of Plain: is a Service, must be a HandService \(crtk_drivers.kit"
    with pytest.raises(PluginError, match=wrong):
        GripperDevice(Plain(), "a test", "hold")


def test_a_service_goes_no_further_where_the_gripper_is_not_enabled_any_more(hand: Spoken) -> None:
    device = enabled(hand)
    steps: Iterator[None] = device.services["release"].run()
    next(steps)
    device.read(time.monotonic())
    for _ in device.disable():
        pass
    with pytest.raises(CommandRefused, match="not enabled any more"):
        next(steps)
    device.read(time.monotonic())
    assert hand.sent == ["loosen"]


def test_a_service_that_begins_as_it_is_disabled_is_stopped(hand: Spoken) -> None:
    """The stop before was read back already."""
    device = enabled(hand)
    next(device.services["release"].run())
    for _ in device.disable():
        pass
    device.read(time.monotonic())
    assert hand.sent == ["stop"]


@pytest.mark.parametrize("service", ["enable", "activate"])
@pytest.mark.parametrize("stands", [True, False])
def test_what_was_broken_off_and_is_seen_to_stand_is_not_stopped_at_the_end(
    hand: Spoken, service: str, stands: bool
) -> None:
    """Whoever moves it then, it was not us."""
    if service == "enable":
        device = enabled(hand)  # and then broken off, before the core knew where it is
    else:
        device = GripperDevice(hand, "a test", "hold")
        device.open(time.monotonic() + 1.0)
        steps: Any = device.services["activate"].run()
        next(steps)
    hand.now = Doing.MOVING
    if service == "enable":
        device.left()
    else:
        steps.close()
    device.read(time.monotonic())
    if stands:
        hand.now = Doing.HOLDS
        device.read(time.monotonic())
    hand.now = Doing.MOVING
    device.close()
    assert hand.sent[-1] == f"closed moves={not stands}"


@pytest.mark.parametrize("doing", [Doing.INACTIVE, Doing.ERROR, Doing.STOPPED])
def test_whether_what_was_held_is_held_still_is_not_made_up(hand: Spoken, doing: Doing) -> None:
    """An arm's payload follows it."""
    hand.capabilities = Capabilities(joints=("x",), limits=(LIMITS,), rate=100.0)
    device = enabled(hand)
    holds = device.readings["holds"]
    assert holds.tell() == Flag(True)
    hand.now = doing
    device.read(time.monotonic())
    assert holds.tell() is None
    hand.now = Doing.LOST
    device.read(time.monotonic())
    assert holds.tell() == Flag(False)


def test_what_it_did_before_the_link_was_lost_is_not_told_as_now(
    hand: Spoken, monkeypatch: pytest.MonkeyPatch
) -> None:
    hand.capabilities = Capabilities(joints=("x",), limits=(LIMITS,), rate=100.0)
    device = enabled(hand)
    monkeypatch.setattr(Spoken, "is_open", False)
    assert hand.doing is Doing.HOLDS
    assert device.readings["holds"].tell() is None
    assert device.readings["grip"].tell() is None


@pytest.mark.parametrize("deaf", [False, True])
def test_that_it_was_not_let_go_at_the_end_is_told(
    hand: Spoken,
    deaf: bool,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if deaf:
        monkeypatch.setattr("crtk_drivers.kit.gripping.gripper_device.FAREWELL", 0.01)
    device = enabled(hand, "release")
    hand.deaf = deaf
    device.will_close()
    with caplog.at_level(logging.WARNING):
        device.close()
    assert ("was not opened" in caplog.text) is deaf
    assert hand.sent == (["closed moves=True"] if deaf else ["let go", "closed moves=False"])
