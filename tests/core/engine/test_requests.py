"""What a device does and takes beyond CRTK, in the process and on ROS."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping

import pytest

from crtk_drivers.commands import Payload
from crtk_drivers.device import Answer, Input, Note, Service, Severity
from crtk_drivers.engine.services import OwnService, Requests
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionLost,
    DataTimeout,
    DeviceFault,
    Reason,
    TransitionFailed,
)
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import Wrench
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.waiting import LONG


class Scale(LoopbackDevice):
    """A gantry that can be tared."""

    def __init__(self, config: LoopbackConfig) -> None:
        super().__init__(config)
        self.bias: Wrench | None = None
        self.go = threading.Event()
        self.closed = threading.Event()

    @property
    def services(self) -> Mapping[str, Service]:
        return {
            "tare": Service("make the present load zero", self._tare),
            "fail": Service("fail", self._fail),
            "wait": Service("wait", self._wait),
            "stumble": Service("raise what it must not", self._stumble),
        }

    @property
    def inputs(self) -> Mapping[str, Input]:
        return {"set_bias": Input("what counts as zero", Payload.WRENCH, self._set_bias)}

    @property
    def notes(self) -> tuple[Note, ...]:
        return (Note(Severity.WARNING, "bias", "unknown"),) if self.bias is None else ()

    def _tare(self) -> Answer:
        for _ in range(3):
            yield
        return "tared in 3 cycles"

    def _fail(self) -> Answer:
        yield
        raise DeviceFault("it is broken", where=self.address)

    def _stumble(self) -> Answer:
        yield
        raise ZeroDivisionError("a mean of nothing")

    def _wait(self) -> Answer:
        try:
            while not self.go.is_set():
                yield
        finally:
            self.closed.set()
        return "waited"

    def _set_bias(self, value: Wrench) -> None:
        if value.force[0] > 100.0:
            raise CommandRefused("set_bias", Reason.OUT_OF_RANGE, "more than it can carry")
        self.bias = value


PLUGIN = DevicePlugin("scale", "a gantry that can be tared", LoopbackConfig, Scale)


@pytest.fixture
def arm() -> Iterator[LocalDevice]:
    session = Session(PLUGIN, LoopbackConfig(transition_time=0.0))
    with LocalDevice(session) as arm:
        session.start()
        arm.measured_js(wait=LONG)
        yield arm


def device_of(arm: LocalDevice) -> Scale:
    device = arm.engine.device
    assert isinstance(device, Scale)
    return device


def test_a_service_is_a_method_that_returns_the_answer_in_any_state(arm: LocalDevice) -> None:
    assert not arm.is_enabled()
    assert arm.tare() == "tared in 3 cycles"
    arm.enable()
    assert arm.tare() == "tared in 3 cycles"


def test_an_error_is_the_answer_and_ends_nothing_else(arm: LocalDevice) -> None:
    arm.enable()
    with pytest.raises(DeviceFault, match="it is broken"):
        arm.fail()
    assert arm.is_enabled()
    assert arm.tare() == "tared in 3 cycles"


def test_a_service_with_a_bug_has_failed_and_the_device_is_in_fault(arm: LocalDevice) -> None:
    arm.enable()
    with pytest.raises(TransitionFailed, match="unexpected ZeroDivisionError: a mean of nothing"):
        arm.stumble()
    assert arm.wait_for_status(lambda status: status.state is OperatingState.FAULT, LONG)
    assert arm.tare() == "tared in 3 cycles"


def test_one_at_a_time(arm: LocalDevice) -> None:
    waiting = arm.engine.request("wait")
    with pytest.raises(CommandRefused, match="wait is running"):
        arm.tare()
    with pytest.raises(DataTimeout, match="wait has not ended"):
        waiting.wait(0.01)
    device_of(arm).go.set()
    assert waiting.wait(LONG) == "waited"
    assert arm.tare() == "tared in 3 cycles"


def test_what_takes_too_long_is_ended(arm: LocalDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arm.engine._requests, "_timeout", 0.05)
    with pytest.raises(TransitionFailed, match=r"wait did not end in 0.05 s"):
        arm.engine.request("wait").wait(LONG)
    assert device_of(arm).closed.wait(LONG)


def test_a_lost_device_answers_at_once(arm: LocalDevice) -> None:
    waiting = arm.engine.request("wait")
    device_of(arm).reachable = False
    with pytest.raises(ConnectionLost):
        waiting.wait(LONG)
    with pytest.raises(CommandRefused) as refused:
        arm.tare()
    assert refused.value.reason is Reason.NOT_CONNECTED


def test_what_is_asked_for_while_the_link_is_lost_fails_at_once_and_is_not_carried_out_later() -> (
    None
):
    """Between a client's look at the link and its question the link may be lost."""
    asked: list[str] = []

    def answer() -> Answer:
        asked.append("tare")
        yield
        return ""

    requests = Requests({"tare": Service("tare", answer)}, "scale", 1.0)
    requests.begin()
    requests.end(ConnectionLost("the link is gone"))
    with pytest.raises(CommandRefused, match="the link is gone") as refused:
        requests.ask("tare")
    assert refused.value.reason is Reason.NOT_CONNECTED
    requests.begin()
    requests.step(0.0, lambda now: False, list)
    assert not asked
    requests.ask("tare")
    requests.step(0.0, lambda now: False, list)
    assert asked


def test_one_that_moves_begins_when_it_may_however_late_it_was_asked_for() -> None:
    asked: list[str] = []
    leave: list[float] = []

    def answer() -> Answer:
        asked.append("sweep")
        yield
        return ""

    def not_yet(now: float) -> bool:
        leave.append(now)
        return now > 1.0

    requests = Requests({"sweep": Service("sweep", answer, moves=True)}, "scale", 1.0)
    requests.begin()
    requests.step(0.0, not_yet, list)
    assert not leave
    requests.ask("sweep")
    requests.step(1.0, not_yet, list)
    assert (leave, asked) == ([1.0], [])
    requests.step(1.5, not_yet, list)
    requests.step(1.6, not_yet, list)
    assert (leave, asked) == ([1.0, 1.5], ["sweep"])


def test_inputs_are_methods_that_check(arm: LocalDevice) -> None:
    arm.set_bias([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    bias = device_of(arm).bias
    assert bias is not None
    assert bias.force.tolist() == [1.0, 2.0, 3.0]
    for bad, text in (([101.0, *[0.0] * 5], "more than"), ([1.0], "it has 1 numbers")):
        with pytest.raises(CommandRefused, match=text):
            arm.set_bias(bad)
    assert device_of(arm).bias is bias
    assert sum(arm.health().refusals.values()) == 2


def test_notes_are_in_the_health(arm: LocalDevice) -> None:
    assert [note.text for note in arm.health().notes] == ["unknown"]


def test_a_mistake_in_one_of_the_drivers_own_is_told_to_who_asks(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Raised into what serves it on ROS, it left him without an answer."""

    def stumble() -> str:
        raise OSError("Stale file handle")

    request = OwnService("stumbles", stumble).carried_out("dump")
    with pytest.raises(TransitionFailed, match=r"dump: unexpected OSError: Stale file handle"):
        request.wait(0.0)
    assert "dump failed" in caplog.text
