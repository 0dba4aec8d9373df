"""The process of a haptic device at a scripted device and a scripted driver, on a clock of its own."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, cast

import pytest

from crtk_drivers.kit.child_process import Parent
from crtk_drivers.kit.haptics import ZERO, Motion, Triple, child_messages, servo
from crtk_drivers.kit.haptics.child_messages import Kind
from crtk_drivers.kit.haptics.servo import HandReading, HandState, Servo
from crtk_drivers.kit.haptics.triples import size
from rigs.waiting import LONG

START = 1000.0
PULL = json.dumps({"pull": {"kind": "spring", "point": [0.02, 0, 0], "stiffness": 100}})
MOST = 2.0
"""N that it pulls with."""


class Clock:
    def __init__(self) -> None:
        self.now = START

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class ScriptedHand:
    """A device that notes what is asked of it, and when."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.forces_on = self.is_late = False
        self.calls: list[tuple[float, str, Any]] = []
        self.deaf = 0
        self._end = threading.Event()

    def _note(self, what: str, value: Any = None) -> None:
        self.calls.append((self._clock.now - START, what, value))

    def open(self, options: Mapping[str, Any]) -> Mapping[str, Any]:
        return {}

    def close(self) -> None:
        self._note("close")

    def read(self) -> HandReading:
        return HandReading(Motion(ZERO))

    def state(self) -> HandState:
        return HandState(True, self.forces_on, "switched off", self.is_late, self.is_late)

    def push(self, force: Triple, torque: Triple, grip: float) -> bool:
        self._note("push", size(force))
        return False

    def enable(self, on: bool) -> None:
        self._note("enable", on)
        self.forces_on = on

    def use_gravity_compensation(self, on: bool) -> None:
        """As it likes."""

    def home(self) -> None:
        self._end.wait(LONG)
        raise servo.HandError("ended")

    def end_homing(self) -> None:
        self._note("end_homing")
        self.deaf -= 1
        if self.deaf < 0:
            self._end.set()

    def trip(self) -> None:
        self.forces_on, self.is_late = False, True

    def by_button(self) -> None:
        self.forces_on, self.is_late = False, False

    def pushed(self, begin: float, end: float) -> list[float]:
        found = [n for at, what, n in self.calls if what == "push" and begin < at < end]
        assert found
        return found

    def when(self, what: str) -> list[float]:
        return [at for at, each, _ in self.calls if each == what]


class Script:
    """The driver: a word in each cycle, and what else comes when."""

    def __init__(self, clock: Clock, **timing: Any) -> None:
        self._clock = clock
        self._timing = {"rate": 1000.0, "told": 5, "driver_timeout": 0.1, "grip": 0.0, **timing}
        self._is_open = self.is_silent = self.is_full = False
        self.moments: deque[tuple[float, bytes | Callable[[], None]]] = deque()
        self.heard: list[tuple[float, Kind, dict[str, Any]]] = []
        self.ends = 2.0

    def receive(self, wait: float = 0.0) -> list[bytes] | None:
        if not self._is_open:
            self._is_open = True
            options = {"hand": {}, "timing": self._timing, "tank": {}, "follow": {}}
            limits = {"force": 8.0, "ramp": 0.1}
            return [child_messages.text(Kind.OPEN, 0, {**options, "limits": limits})]
        now = self._clock.now - START
        if now > self.ends:
            return None
        said = [] if self.is_silent else [child_messages.order(Kind.ALIVE, 0)]
        while self.moments and self.moments[0][0] <= now:
            what = self.moments.popleft()[1]
            if isinstance(what, bytes):
                said.append(what)
            else:
                what()
        return said

    def send(self, message: bytes) -> bool:
        kind = Kind(message[:1])
        if self.is_full:
            return False
        told = {} if kind is Kind.STATE else child_messages.text_of(message)[1]
        self.heard.append((self._clock.now - START, kind, told))
        return True

    def set(self, name: str, value: bool) -> Callable[[], None]:
        return lambda: setattr(self, name, value)

    def told(self, kind: Kind) -> list[tuple[float, dict[str, Any]]]:
        return [(at, told) for at, each, told in self.heard if each is kind]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(servo, "time", clock)
    monkeypatch.setattr(servo, "ask_for_real_time", lambda priority: None)
    monkeypatch.setattr(servo, "_ENDS", 3.0)  # of a real thread, on a busy machine
    return clock


def ran(
    clock: Clock,
    script: Script,
    *moments: tuple[float, bytes | Callable[[], None]],
    hand: ScriptedHand,
) -> None:
    """Enable it with a fixture at once, and then what the moments say."""
    begins = (
        child_messages.text(Kind.FIXTURES, 1, {"text": PULL}),
        child_messages.order(Kind.ENABLE, 2),
    )
    script.moments.extend([*((0.0, each) for each in begins), *moments])
    Servo(cast(Parent, script), hand).run()
    assert hand.calls[-1][1] == "close"


def test_after_a_silence_of_the_driver_forces_begin_from_zero(clock: Clock) -> None:
    hand, script = ScriptedHand(clock), Script(clock)
    silent, heard = script.set("is_silent", True), script.set("is_silent", False)
    ran(clock, script, (0.5, silent), (0.62, heard), hand=hand)
    assert hand.pushed(0.4, 0.5)[-1] == pytest.approx(MOST)
    assert not any(hand.pushed(0.605, 0.619))
    assert max(hand.pushed(0.62, 0.63)) < 0.2 * MOST
    assert hand.pushed(0.62, 0.8)[-1] == pytest.approx(MOST)


def test_a_second_trip_of_its_watchdog_needs_enable(clock: Clock) -> None:
    hand, script = ScriptedHand(clock), Script(clock, trips=1)
    ran(clock, script, (0.5, hand.trip), (1.0, hand.trip), hand=hand)
    assert max(hand.pushed(0.521, 0.53)) < 0.3 * MOST
    assert hand.pushed(0.9, 1.0)[-1] == pytest.approx(MOST)
    ((at, told),) = script.told(Kind.WITHDRAWN)
    assert 1.0 < at < 1.03
    assert told["is_fault"]
    assert not hand.forces_on
    enabled = [index for index, (_, what, on) in enumerate(hand.calls) if what == "enable" and on]
    assert len(enabled) == 2
    assert all(hand.calls[index - 1][1:] == ("push", 0.0) for index in enabled), "zero before that"


def test_after_a_while_a_trip_is_forgiven_again(clock: Clock) -> None:
    hand, script = ScriptedHand(clock), Script(clock, trips=1)
    script.ends = 11.5
    ran(clock, script, (0.5, hand.trip), (11.0, hand.trip), hand=hand)
    assert not script.told(Kind.WITHDRAWN)


def test_a_process_that_stood_for_long_does_not_switch_forces_on_again(clock: Clock) -> None:
    hand, script = ScriptedHand(clock), Script(clock, trips=1000)

    def stands() -> None:
        clock.sleep(1.0)
        hand.trip()

    ran(clock, script, (0.5, stands), hand=hand)
    assert script.told(Kind.WITHDRAWN)
    assert not hand.forces_on


def test_forces_that_were_switched_off_at_the_device_are_zero_when_they_are_let_go(
    clock: Clock,
) -> None:
    hand, script = ScriptedHand(clock), Script(clock)
    ran(clock, script, (0.5, hand.by_button), hand=hand)
    last = [(what, value) for at, what, value in hand.calls if 0.5 < at < 1.9]
    assert last[-2:] == [("push", 0.0), ("enable", False)]
    assert not script.told(Kind.WITHDRAWN)[0][1]["is_fault"]


def test_what_a_driver_must_know_is_told_when_it_reads_again(clock: Clock) -> None:
    hand, script = ScriptedHand(clock), Script(clock)
    full, empty = script.set("is_full", True), script.set("is_full", False)
    ran(clock, script, (0.4, full), (0.5, hand.by_button), (1.0, empty), hand=hand)
    ((at, _),) = script.told(Kind.WITHDRAWN)
    assert 1.0 <= at < 1.01
    assert all(at < 0.4 or at >= 1.0 for at, _ in script.told(Kind.STATE))


def test_homing_ends_when_nobody_is_heard_who_could_stop_it(clock: Clock) -> None:
    hand, script = ScriptedHand(clock), Script(clock)
    home = child_messages.order(Kind.HOME, 3)
    ran(clock, script, (0.4, home), (0.5, script.set("is_silent", True)), hand=hand)
    assert 0.6 <= hand.when("end_homing")[0] < 0.61
    assert "nobody was heard" in script.told(Kind.REPLY)[-1][1]["text"]


def test_homing_is_told_to_end_until_it_does(clock: Clock) -> None:
    hand, script = ScriptedHand(clock), Script(clock)
    hand.deaf = 3
    stop = child_messages.order(Kind.HOME, 3), child_messages.order(Kind.STOP, 4)
    ran(clock, script, *((0.4, each) for each in stop), hand=hand)
    assert len(hand.when("end_homing")) == 4
    assert hand.when("close")[-1] > 1.9, "and its process goes on"


def test_homing_ends_with_the_driver(clock: Clock) -> None:
    hand, script = ScriptedHand(clock), Script(clock)
    script.ends = 0.5
    ran(clock, script, (0.4, child_messages.order(Kind.HOME, 3)), hand=hand)
    assert [what for _, what, _ in hand.calls[-2:]] == ["end_homing", "close"]
