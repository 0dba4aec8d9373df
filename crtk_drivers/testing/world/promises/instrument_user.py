"""What a user does with a device that measures, at random: reads, tares, asks, closes it, connects anew.

The scenario takes a world and an instrument. Wrap it into a function of the world alone, at the top level of
a file, and it can be run with any seed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Final

import numpy as np

from crtk_drivers.errors import CommandRefused, CrtkError, DataTimeout, Reason, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import Wrench, vector
from crtk_drivers.state import OperatingState, StateCommand
from crtk_drivers.testing.world.promises.acting import MOMENT, attempt
from crtk_drivers.testing.world.promises.instrument import (
    RAW,
    ForceSensor,
    Instrument,
    Numbers,
    Sight,
)
from crtk_drivers.testing.world.promises.instrument_judges import judge
from crtk_drivers.testing.world.promises.judges import CLOCKS, SETTLED
from crtk_drivers.testing.world.promises.user import COMES_BACK, close, connects, storm
from crtk_drivers.testing.world.world import World

_PATIENCE: Final = 10.0
_CHECKED: Final = 0.15
"""s before the end of `bias` in which what was measured is like the bias: a driver looks for 0.1 s."""
_STOPS_SENDING: Final = 0.3
"""s before `close` in which the network let all pass, where a request to stop counts as come."""
_EXPECTED: Final = (Reason.TRANSITION_RUNNING, Reason.INVALID_TRANSITION, Reason.EMPTY)
"""Reasons for which a command is refused that comes too early, or in another state."""


def watch(world: World, instrument: Instrument, *, operations: int = 12, faults: int = 6) -> None:
    """Read a device and set it in any way for some seconds, in one to three sessions.

    Args:
        world, instrument: where and what.
        operations: how many things the user does.
        faults: how many come meanwhile, at most.
    """
    sight = Sight(world, instrument)
    judge(sight)

    def session(count: int) -> None:
        sight.closing = sight.closed = None
        if not connects(sight, COMES_BACK):
            return
        user = _User(sight)
        user.work(count)
        user.wait_for_values()
        close(sight)
        if text := _goes_on(sight):
            world.find("it sends after close", text)
        sight.arm = None

    def drive() -> None:
        storm(world, 0.25 * operations, faults)
        sessions = world.random.choice((1, 1, 2, 3))
        for _ in range(sessions):
            session(operations // sessions)

    world.join(world.start("driver", drive))


def _goes_on(sight: Sight) -> str:
    """Say that the simulator sends after its driver was closed, where nothing was in the way of a stop."""
    closing, closed = sight.closing, sight.closed
    if closing is None or closed is None or not sight.sends:
        return ""
    if sight.hindered > closing - _STOPS_SENDING:
        return ""
    return f"it was closed {sight.now - closed:.2f} s ago, and nothing was in the way"


class _User:
    """A user of a device that measures, who chooses by the world's generator.

    Args:
        sight: with the driver connected.
    """

    def __init__(self, sight: Sight) -> None:
        assert sight.arm is not None
        self._sight = sight
        self._arm: LocalDevice = sight.arm
        self._random = sight.world.random
        self._setting = threading.Lock()
        self._sets = 0
        """How often somebody has begun to set a bias."""
        self._actions: dict[str, Callable[[], None]] = {
            "read": self._read,
            "wait for a value": self._wait_for_value,
            "enable": self._enable,
            "disable": lambda: self._arm.disable(_PATIENCE),
            "pause": lambda: self._arm.state_command(StateCommand.PAUSE, _PATIENCE),
            "rest": lambda: self.pause(0.6),
        }
        force = {
            "bias": self._bias,
            "unbias": self._unbias,
            "set_bias": self._set_bias,
            "two biases": self._two_biases,
            "sensor_bias": lambda: self._ask("sensor_bias"),
            "sensor_unbias": lambda: self._ask("sensor_unbias"),
        }
        others = {
            name: lambda name=name: self._ask(name) for name in ("get_bias", "clear_latch", "beep")
        }
        known = {*self._arm.extras, "two biases" if "bias" in self._arm.extras else ""}
        self._actions |= {name: act for name, act in (force | others).items() if name in known}

    def work(self, operations: int) -> None:
        """Do so many things."""
        names = tuple(self._actions)
        if not isinstance(self._sight.instrument, ForceSensor):
            self.attempt("enable", self._enable)
        for _ in range(operations):
            name = self._random.choice(names)
            self.attempt(name, self._actions[name])

    def attempt(self, name: str, action: Callable[[], None]) -> None:
        """Do something that may be refused, with a reason."""
        world, sight = self._sight.world, self._sight
        world.say(f"{name}, {self._arm.operating_state().state}")
        begun = sight.now
        if world.wild:
            world.troubles.around(MOMENT, chance=0.1)
        attempt(world, name, action, lambda error: self._is_no_wonder(error, begun))

    def _is_no_wonder(self, error: CrtkError, begun: float) -> bool:
        """Whether something fails for what the user or the load does."""
        if isinstance(error, TransitionFailed):
            return self._sight.changed > begun
        if isinstance(error, DataTimeout):
            return self._is_missing(begun)
        return isinstance(error, CommandRefused) and error.reason in _EXPECTED

    def _is_missing(self, begun: float) -> bool:
        sight = self._sight
        spans = [sight.was(name, begun - 0.3, sight.now) for name in sight.acting]
        is_off = not isinstance(sight.instrument, ForceSensor) and not self._arm.is_enabled()
        return is_off or any(span is None or span.is_missing for span in spans)

    def pause(self, most: float) -> None:
        """Do nothing for a while."""
        time.sleep(self._random.random() * most)

    # ---------------------------------------------------------------------------------------- reading

    def wait_for_values(self) -> None:
        """Wait until it measures, once nothing goes wrong any more: it comes back by itself."""
        sight, world = self._sight, self._sight.world
        begun = sight.now
        while sight.now < max(begun, sight.hindered) + COMES_BACK:
            if not isinstance(sight.instrument, ForceSensor) and not self._arm.is_enabled():
                self.attempt("enable", self._enable)
            if any(sight.found(name) is not None for name in sight.acting):
                return
            time.sleep(0.05)
        world.find(
            "it does not come back",
            f"no value for {sight.now - begun:.1f} s; it is {self._arm.operating_state()}",
        )

    def _reading(self) -> str:
        return self._random.choice(tuple(self._sight.acting))

    def _get(self, reading: str, age: float, wait: float) -> float:
        """Read a value as users do; return its stamp (s) on the wall's clock."""
        child, _, name = reading.rpartition(".")
        device = self._arm.child(child) if child else self._arm
        found = device
        for part in name.split("/"):
            found = getattr(found, part)
        stamp: float = found(age=age, wait=wait, extra=True)[1]  # type: ignore[operator]
        return stamp

    def _read(self) -> None:
        self._get(self._reading(), age=self._random.choice((0.0, 0.1, 0.5)), wait=0.0)

    def _wait_for_value(self) -> None:
        """Wait for a value of a bounded age: it is not older, nor waited for longer."""
        sight, world = self._sight, self._sight.world
        age, wait = self._random.choice((0.02, 0.1)), self._random.choice((0.1, 1.0, 3.0))
        begun, offset = sight.now, world.kernel.wall_offset
        stamp = self._get(self._reading(), age=age, wait=wait)
        took = sight.now - begun
        is_told = world.kernel.wall_offset == offset and begun > sight.disturbed + SETTLED
        if is_told and time.time() - stamp > age + CLOCKS + took:
            world.find(
                "it was not so", f"a value of at most {age:g} s is {time.time() - stamp:.3f} s old"
            )

    # ------------------------------------------------------------------------------------------ state

    def _enable(self) -> None:
        if self._arm.operating_state().state == OperatingState.PAUSED:
            self._arm.state_command(StateCommand.RESUME, _PATIENCE)
        elif not self._arm.is_enabled():
            self._arm.enable(_PATIENCE)
        children = [self._arm.child(name) for name in self._arm._children]  # noqa: SLF001 - all of them
        for child in children:
            if child.engine.has_state and not child.is_enabled():
                child.enable(_PATIENCE)

    # --------------------------------------------------------------------------------------- services

    def _ask(self, service: str) -> None:
        self._sight.world.say(f"  {self._arm.extras[service](_PATIENCE)}")

    def _bias(self) -> None:
        """Tare: the bias is then what was measured at the end, or as before."""
        sight, before, begun = self._sight, self._sight.bias(), self._sight.now
        self._sets += 1
        sets = self._sets
        try:
            self._ask("bias")
            sight.look()  # before another sets another
        except TransitionFailed:
            if self._sets == sets and sight.bias() != before:
                sight.world.find(
                    "a bias is wrong", f"it was {before}; bias failed, and it is {sight.bias()}"
                )
            raise
        if self._sets == sets and sight.disturbed < begun - SETTLED:
            self._is_so("bias", sight.bias(), begun)

    def _is_so(self, name: str, bias: Numbers, begun: float) -> None:
        """Report a bias that is not what was measured when it was checked."""
        sight, instrument = self._sight, self._sight.instrument
        assert isinstance(instrument, ForceSensor)
        since = max(begun, sight.now - _CHECKED)
        span = sight.was(RAW, since - instrument.early, sight.now)
        allowed = np.add(instrument.error, instrument.drift).tolist()
        if span is not None and not span.has(bias, allowed):
            sight.world.find(
                "a bias is wrong",
                f"{name} made it {bias}; it was between {span.lower} and {span.upper} at the end",
            )

    def _unbias(self) -> None:
        self._sets += 1
        sets = self._sets
        self._ask("unbias")
        if self._sets == sets and any(self._sight.bias()):
            self._sight.world.find("a bias is wrong", f"it is {self._sight.bias()} after unbias")

    def _set_bias(self) -> None:
        numbers = [self._random.choice((-1.0, 0.0, 1.0)) * self._random.random() for _ in range(6)]
        self._sets += 1
        sets = self._sets
        self._arm.extras["set_bias"](Wrench(vector(numbers[:3]), vector(numbers[3:])))
        self._sight.biases.note(self._sight.now, tuple(numbers))  # another may follow at once
        if self._sets == sets and self._sight.bias() != tuple(numbers):
            self._sight.world.find(
                "a bias is wrong", f"{numbers} was set, and it is {self._sight.bias()}"
            )

    def _two_biases(self) -> None:
        """Set a bias while another is being measured."""
        delay = 0.5 * self._random.random()

        def other() -> None:
            time.sleep(delay)
            self.attempt("set_bias", self._set_bias)

        thread = threading.Thread(target=other, name="second client")
        thread.start()
        try:
            self._bias()
        finally:
            thread.join()
