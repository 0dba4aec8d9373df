"""A driver in this process at its simulator, commanded and looked at by one thread."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple
from unittest.mock import patch

import numpy as np
from typing_extensions import override

from bench.reliability import disturbed
from bench.reliability.activities import EFFORTS, HOME, OF_THE_TOOL, STANDING, Activity, Plan
from bench.reliability.disturbed import DisturbedDevice
from bench.reliability.stamps import Look, held_up, too_young
from bench.reliability.table import Absent, Way
from crtk_drivers.config import DeviceConfig, from_values, load
from crtk_drivers.engine import Engine, Observer, threads
from crtk_drivers.errors import (
    CommandRefused,
    CrtkError,
    DeviceError,
    MotionAborted,
    StopUnconfirmed,
)
from crtk_drivers.front import LocalDevice
from crtk_drivers.motion.stopping import UNSEEN
from crtk_drivers.plugins import DevicePlugin, RunningSim
from crtk_drivers.samples import Stamp
from crtk_drivers.session import Session
from crtk_drivers.state import Status
from crtk_sim_backends.simulator import Simulator

PATIENCE = 20.0
"""Seconds for what has no bound of its own: connecting, enabling, going home."""

SLACK = 3.0
"""Seconds that a busy machine may add to each declared time before a test fails."""

LOOK = 0.004
"""Seconds between two looks at the joints."""

SELDOM = 0.01
"""The same in tests, which do not measure how long something took."""

STILL = 0.15
"""Seconds in which joints that stand have not moved."""

FEW = 4
"""Looks in which they have not."""

HELD_UP = 1.0
"""Seconds for which a thread or a process may get no time on a busy machine: a simulator, too."""

STALL_LIMIT = 2.0
"""Seconds for which an I/O thread may get no time on a busy machine before it counts as stuck."""

SPEED_UP = 0.1
"""Seconds that an arm that moves goes on before a fault meets it."""

CLOCK = "own clock"
PAUSE = "own pause"
FROZEN = "own frozen"
OWN_KINDS = frozenset({CLOCK, PAUSE, FROZEN, *disturbed.KINDS})
"""Kinds of fault that every rig has, beside those of its simulator: `disturbed.KINDS`, and

- `CLOCK`: the system clock jumps by `seconds`;
- `PAUSE`: the I/O thread gets no time for `seconds`;
- `FROZEN`: the simulator's process gets no time (SIGSTOP), for `seconds` or until the fault ends.
"""


class BrokenPromiseError(AssertionError):
    """Something did not follow that the table of faults says."""


class Announced(NamedTuple):
    """A status and when (monotonic s) it was announced."""

    at: float
    status: Status


class Log(Observer):
    """Everything that the driver announced and refused."""

    def __init__(self) -> None:
        self.announced: list[Announced] = []
        self.refused: list[CommandRefused] = []

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        self.announced.append(Announced(stamp.monotonic, status))

    @override
    def command_refused(self, refusal: CommandRefused) -> None:
        self.refused.append(refusal)


class Rig(ABC):
    """One driver and its simulator. A context manager.

    Class attributes:
        name: of the driver, as in the table.
        plugin: of the driver.
        simulator, sim_options: its simulator, None where there is none, and how that is started.
        ways, absent: its part of the table.
        plan: how its arm is moved.
        activities: what it can do.
        values: configuration in which a busy machine is no fault; `defaults`: for measuring.
        thorough: one fault is met in every activity in CI, too.
        tolerance: how far (rad, m) joints that stand may seem to move.
        belated: seconds after the end of a fault in which it may still be reported.
        homes_on: seconds for which the hardware goes on homing at most where the link is lost. What goes on
            by itself in one fault, whatever it was doing, says `Way.runs_on`.
        services: those that move a device that is not ENABLED; a walk asks for them, too.
        stop_time: declared s in which joints stand after a stop; what the driver declares if None.
        arrival: how far (rad, m) from its goal a move that began in motion may seem to be, in a walk.
        younger: seconds by which each stamp may seem too young, see `stamps`; `Way.younger` adds to it.
    """

    name: ClassVar[str]
    plugin: ClassVar[DevicePlugin]
    simulator: ClassVar[Simulator[Any, Any] | None] = None
    sim_options: ClassVar[Mapping[str, Any]] = {}
    ways: ClassVar[tuple[Way, ...]]
    absent: ClassVar[tuple[Absent, ...]]
    plan: ClassVar[Plan] = Plan(0.0, 0.0)
    activities: ClassVar[tuple[str, ...]]
    values: ClassVar[Mapping[str, Any]] = {}
    defaults: ClassVar[Mapping[str, Any]] = {}
    tolerance: ClassVar[float] = 3e-3
    belated: ClassVar[float] = 0.0
    homes_on: ClassVar[float] = 0.0
    services: ClassVar[tuple[str, ...]] = ()
    stop_time: ClassVar[float | None] = None
    arrival: ClassVar[float] = 0.1
    younger: ClassVar[float] = 0.02
    thorough: ClassVar[bool] = True
    second: ClassVar[str] = "in use"
    """Words with which a second host is refused."""

    def __init__(self, *, patient: bool = True) -> None:
        self.patient = patient
        self.looks: list[Look] = []
        self.activity: Activity | None = None
        self._streams = True
        self._turned = False
        self._stack = contextlib.ExitStack()
        self._fault: Way | None = None
        self._unwatched = False
        self._frozen = False
        self._goes_on_at = math.inf
        self._measured: tuple[Any, Stamp] | None = None

    # ------------------------------------------------------------------------------ of each driver

    def start_sim(self) -> RunningSim | None:
        """Start the simulator, if there is one."""
        return None if self.simulator is None else self.simulator.spawn(**self.sim_options)

    @abstractmethod
    def joints(self) -> np.ndarray:
        """Return where the joints really are, rad (m); empty if there are none."""

    def powered(self) -> bool | None:
        """Return whether a joint has power; None if the simulator cannot tell."""
        return None

    @property
    def enable_moves(self) -> bool:
        """Whether `enable` would move the joints now, to make the device ready."""
        return False

    @property
    def keeps_power(self) -> bool:
        """Whether joints are to be left with power when the driver ends."""
        return getattr(self.config, "on_close", None) == "hold"

    @property
    def named(self) -> str:
        """What an error of the connection must name: host, port, interface."""
        return self.engine.device.address.split()[0].partition(":")[0]

    # ---------------------------------------------------------------------------------- life cycle

    def __enter__(self) -> Rig:
        with self._stack as opened:  # which is closed where this ends early
            opened.enter_context(patch.object(threads, "STALL_LIMIT", self.stall_limit))
            self.sim = self.start_sim()
            if self.sim is not None:
                opened.callback(self.sim.stop)
            self.open()
            opened.callback(self.close)
            self._stack = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def stall_limit(self) -> float:
        """Seconds for which an I/O thread may get no time."""
        return STALL_LIMIT if self.patient else threads.STALL_LIMIT

    @property
    def config(self) -> DeviceConfig:
        """The driver's configuration, pointing at the simulator."""
        values = {**self.defaults, **(self.values if self.patient else {})}
        config = load(self.plugin.config, from_values(values))
        if self.sim is None:
            return config
        pointed: DeviceConfig = self.plugin.sim_config(config, self.sim)
        return pointed

    @property
    def own_config(self) -> DeviceConfig:
        """That of drivers in this process; those in processes of their own have `config`."""
        return self.config

    def session(self) -> Session:
        """Return another session at the same simulator, not started."""

        def create(config: DeviceConfig) -> DisturbedDevice:
            return DisturbedDevice(self.plugin.create(config))

        return Session(replace(self.plugin, create=create), self.own_config)

    def open(self, *, start: bool = True, wait: bool = True) -> None:
        """Begin a session of the driver."""
        self.driver = self.session()
        self.arm: Any = LocalDevice(self.driver)
        self.engine: Engine = self.driver.engine
        self.log = Log()
        self.engine.add_observer(self.log)
        if start:
            self.driver.start()
        if start and wait:
            self.until(lambda: self.connected, PATIENCE, "it is connected")

    def close(self) -> None:
        """End the session. Who lost the link in motion, or sees no joints, says so."""
        self.activity = None
        was_seen = self.connected and self._sees_joints
        try:
            self.driver.close()
        except StopUnconfirmed as error:
            if was_seen and UNSEEN not in str(error):
                raise

    @property
    def moves_joints(self) -> bool:
        """Whether it has joints, and commands that move them."""
        return bool(self.engine.capabilities.joints and self.engine.capabilities.modes)

    @property
    def _sees_joints(self) -> bool:
        """Whether the driver knows where the joints are, or there are none."""
        if not self.engine.capabilities.joints:
            return True
        return self.valid("measured_js") is not None

    def valid(self, name: str) -> tuple[Any, Stamp] | None:
        """Return a feedback and its stamp if it is published as valid."""
        found = self.engine.feedback(name)
        return None if found is None or found[1].wall_ns == 0 else found

    def close_watched(self) -> bool:
        """End the session, and look at the joints meanwhile; return whether it said nothing.

        What could not be confirmed may be said.
        """
        said: list[DeviceError] = []

        def close() -> None:
            try:
                self.driver.close()
            except DeviceError as error:
                said.append(error)

        self.activity = None
        closing = threading.Thread(target=close)
        closing.start()
        self.until(lambda: not closing.is_alive(), PATIENCE, "it is closed")
        return not said

    def reopen(self) -> None:
        """End the session and begin another."""
        self.close()
        self.open()

    # -------------------------------------------------------------------------------- what it does

    @property
    def disturbed(self) -> DisturbedDevice:
        """The device, which can be made to fail."""
        device = self.engine.device
        while not isinstance(device, DisturbedDevice):
            device = device.inner  # type: ignore[attr-defined]
        return device

    @property
    def connected(self) -> bool:
        """Whether it is, and measures."""
        return self.engine.connected and self.engine.has_sample

    @property
    def status(self) -> Status:
        """Of the driver."""
        return self.engine.status

    def step(self) -> None:
        """Go on with the activity and look at the joints, once."""
        if time.monotonic() >= self._goes_on_at:
            self._go_on()
        if self.activity is not None and self._streams:
            try:
                self.activity.send()
            except CommandRefused as refusal:
                self.require(bool(refusal.detail), f"a refusal without a reason: {refusal!r}")
            except CrtkError as error:
                if "kinematics" not in type(error).__name__.lower():
                    raise
        self.look()
        self.check_stamps()
        self.check_ranges()
        time.sleep(SELDOM if self.patient else LOOK)

    def look(self) -> Look:
        """Look at the joints."""
        at = time.monotonic()
        # A process that stands still answers nothing, and moves nothing.
        joints = self.looks[-1].joints if self._frozen and self.looks else self.joints()
        look = Look(at, joints, time.monotonic())
        self.looks.append(look)
        return look

    def check_stamps(self) -> None:
        """Check promise 4: what is stamped as fresh is fresh."""
        for name in ("measured_js", "measured_cf"):
            if name not in self.engine.commands:
                continue
            found = self.valid(name)
            if found is None:
                continue
            age = time.monotonic() - found[1].monotonic
            oldest = self.engine.options.sample_timeout + SLACK
            self.require(age < oldest, f"{name} is stamped as valid, but is {age:.3f} s old")
        self._check_youth()

    def _check_youth(self) -> None:
        """Require that the joints were where `measured_js` says at the time of its stamp, or later."""
        before, self._measured = self._measured, self.valid("measured_js")
        if before is None:
            return
        value, stamp = before
        younger = too_young(self.looks, value.position, stamp.monotonic, self.tolerance)
        allowed = self.younger + (0.0 if self._fault is None else self._fault.younger)
        if (
            self.patient
        ):  # whoever gives no time to this thread gives none to a bus and its simulator
            allowed += held_up(self.looks, SELDOM)
        self.require(
            younger <= allowed,
            f"measured_js is stamped {younger:.3f} s too young, allowed are {allowed:.3f}",
        )

    def check_ranges(self) -> None:
        """No joint leaves its range, whatever moves it, as long as its effort is watched."""
        if self._unwatched:
            return
        joints, limits = self.looks[-1].joints, self.engine.capabilities.limits
        room = 10.0 * self.tolerance
        for at, limit in zip(joints, limits, strict=False):
            inside = limit.lower - room <= at <= limit.upper + room
            self.require(
                inside, f"a joint is at {at:.3f}, out of {limit.lower:.3f} to {limit.upper:.3f}"
            )

    def until(self, test: Callable[[], object], timeout: float, what: str) -> float:
        """Step until `test` holds; return when (monotonic s) that was.

        Raises:
            BrokenPromiseError: not within `timeout`.
        """
        deadline = time.monotonic() + timeout
        while not test():
            if time.monotonic() > deadline:
                last = [
                    f"{status.state} ({status.detail})" for _, status in self.log.announced[-4:]
                ]
                detail = f"{self.status.state} ({self.status.detail}), after {last}"
                raise BrokenPromiseError(f"never within {timeout:.2f} s: {what}; it is {detail}")
            self.step()
        return time.monotonic()

    def run(self, seconds: float) -> None:
        """Step for so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.step()

    def require(self, holds: bool, what: str) -> None:
        """Raise BrokenPromiseError unless `holds`."""
        if not holds:
            raise BrokenPromiseError(what)

    def still(self, seconds: float = STILL) -> bool:
        """Whether no joint has moved for so long, and in some looks, which may be far between."""
        begin = time.monotonic() - seconds
        count = max(FEW, sum(look.at >= begin for look in self.looks))
        if len(self.looks) <= count:
            return False
        recent = np.array([look.joints for look in self.looks[-count:]])
        return float(np.ptp(recent, axis=0).max(initial=0.0)) < self.tolerance / 2

    def until_still(self, timeout: float = PATIENCE) -> np.ndarray:
        """Wait until all joints stand; return where."""
        self.until(self.still, timeout, "all joints stand")
        return self.looks[-1].joints

    def ready(self) -> None:
        """No fault, ENABLED, at rest at home or near it, and nothing noted yet."""
        self.stop_activity()
        self.end_fault()
        self.until(lambda: self.connected, PATIENCE, "it is connected")
        self.by_hand()
        self.enable()
        self.be_homed()
        if self.moves_joints:
            self._begin_at_home()
        self._unwatched = False
        self.looks.clear()
        self.log.announced.clear()
        self.log.refused.clear()

    def _begin_at_home(self) -> None:
        """Stand at home or near it. A device that was not heard for a moment on the way begins again."""
        for again in (True, True, False):
            try:
                self.arm.hold()
                if np.abs(self.until_still() - self.home()).max() > self.plan.room:
                    self.go_home()
            except (CommandRefused, MotionAborted):
                if not again or not self.patient:
                    raise
                self.until(lambda: self.connected, PATIENCE, "it is connected")
                self.enable()
            else:
                return

    def go_home(self) -> None:
        """Move all joints to where they began."""
        move = self.arm.move_jp(self.home())
        self.until(lambda: not move.is_busy(), PATIENCE, "it is at home")
        move.wait(0.0)
        self.until_still()

    def by_hand(self) -> None:  # noqa: B027  # most drivers move a joint back themselves
        """Put back what stands outside of its range, where a person would have to."""

    def home(self) -> np.ndarray:
        """Return where moves begin, rad (m)."""
        return np.zeros(len(self.engine.capabilities.joints))

    def enable(self) -> None:
        """Enable or resume, as often as it takes, once what was commanded before has come to its end."""
        deadline = time.monotonic() + PATIENCE
        self.until(lambda: self.engine.transition_ended, PATIENCE, "a transition ends")
        while self.status.state != "ENABLED":
            with contextlib.suppress(CommandRefused):
                self.engine.state_command("resume" if self.status.state == "PAUSED" else "enable")
            self.until(lambda: self.engine.transition_ended, PATIENCE, "enable ends")
            if time.monotonic() > deadline:
                refused = [str(refusal) for refusal in self.log.refused[-2:]]
                raise BrokenPromiseError(f"it cannot be enabled again: {self.status}, {refused}")
            if self.status.state != "ENABLED":
                self.run(0.1)

    def be_homed(self) -> None:
        """Home what is not, if homing is one of its activities: its positions count from there on."""
        if HOME not in self.activities or self.status.is_homed:
            return
        with contextlib.suppress(CommandRefused):
            self.engine.state_command(HOME)
        self.until(lambda: self.engine.transition_ended, PATIENCE, "home ends")
        refused = [str(refusal) for refusal in self.log.refused[-2:]]
        self.require(self.status.is_homed, f"it cannot be homed: {self.status}, {refused}")

    def begin_activity(self, name: str) -> None:
        """Begin what it does, and wait until it does it."""
        start = self.look().joints
        self.activity = Activity(name, self.arm, self.homeward(name))
        if name in STANDING:
            return

        def moves() -> bool:
            return bool(np.abs(self.look().joints - start).max() > 10.0 * self.tolerance)

        for again in (True, True, False):
            try:
                self.until(moves, PATIENCE / 4.0, "it moves")
                break
            except BrokenPromiseError:
                if not again:
                    raise
            # On a busy machine a stream may stall, and its positions run away from the setpoint.
            self.ready()
            start = self.look().joints
            self.activity = Activity(name, self.arm, self.homeward(name))
        self.run(SPEED_UP)

    def homeward(self, name: str) -> Plan:
        """Return the plan in the direction of home; of the tool, in the other one than last time."""
        if name in OF_THE_TOOL:
            self._turned = not self._turned
            turned = self._turned
        else:
            turned = bool((self.looks[-1].joints > self.home())[:1].any())
        return self.plan.reversed() if turned else self.plan

    def plan_of_walk(self, name: str) -> Plan:
        """Return the plan of an activity in a walk."""
        return self.plan

    def pause_stream(self) -> None:
        """Send no more of the stream."""
        self._streams = False

    def stop_activity(self) -> None:
        """Send nothing more. A stream that begins later is sent again."""
        self.activity = None
        self._streams = True

    # --------------------------------------------------------------------------------------- faults

    def begin_fault(self, way: Way) -> float:
        """Let a fault begin; return when (monotonic s)."""
        self._fault = way
        began = time.monotonic()
        if way.fault == "F17" and self.activity is not None and self.activity.name in EFFORTS:
            self._unwatched = True  # until it has been moved back
        if way.kind in disturbed.KINDS:
            self.disturbed.begin(way.kind)
        elif way.kind == PAUSE:
            self.disturbed.begin(disturbed.STUCK)
            threading.Timer(way.parameters["seconds"], self.disturbed.end).start()
        elif way.kind == CLOCK:
            self._jump(way.parameters["seconds"])
        elif way.kind == FROZEN:
            self._freeze(way.parameters.get("seconds"))
        elif way.kind:
            self.inject(way.kind, **way.parameters)
        return began

    def inject(self, kind: str, **parameters: Any) -> None:
        """Let a fault of the simulator begin."""
        assert self.sim is not None
        self.sim.control.inject(kind, **parameters)

    def _freeze(self, seconds: float | None) -> None:
        """Let the simulator's process stand still for so long, or until `end_fault`."""
        assert self.sim is not None
        self.look()
        self._frozen = True
        self.sim.suspend()
        self._goes_on_at = math.inf if seconds is None else time.monotonic() + seconds

    def _go_on(self) -> None:
        """Let it go on. What was seen until now says nothing of whether joints stand."""
        assert self.sim is not None
        self.sim.resume()
        self._goes_on_at = math.inf
        self._frozen = False
        self.looks.clear()

    def end_fault(self) -> None:
        """End whatever fault there is."""
        way, self._fault = self._fault, None
        if self._frozen:
            self._go_on()
        self.disturbed.end()
        self._clock.close()
        if self.sim is not None:
            self.sim.control.clear()
        if way is not None and way.repair:
            getattr(self, way.repair)()

    @property
    def _clock(self) -> contextlib.ExitStack:
        if not hasattr(self, "_clock_stack"):
            self._clock_stack = contextlib.ExitStack()
        return self._clock_stack

    def _jump(self, seconds: float) -> None:
        wall = time.time_ns
        self._clock.enter_context(
            patch.object(time, "time_ns", lambda: wall() + int(seconds * 1e9))
        )

    @contextmanager
    def second_host(self) -> Iterator[Session]:
        """Another driver at the same simulator, started."""
        session = self.session()
        try:
            session.start()
            yield session
        finally:
            session.close()
