"""What an acquisition has to hand: a device under test, moved within what is allowed, and recorded.

Every wait looks at the watch: when that has tripped, `Tripped` ends the acquisition wherever it is.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Final, Protocol

import numpy as np

from crtk_drivers.config import BoxConfig
from crtk_drivers.device import Note
from crtk_drivers.errors import CrtkError
from crtk_drivers.labs.bench import programs
from crtk_drivers.labs.bench.calls import About, Glance
from crtk_drivers.labs.bench.door import Door, Refused
from crtk_drivers.labs.bench.operator import (
    PERSON_TAKES,
    STOP_LOOK_PERIOD,
    UNNOTICED,
    Operator,
    Pressed,
    pressed,
)
from crtk_drivers.labs.bench.relay import RelayProcess
from crtk_drivers.labs.bench.watch import Watch
from crtk_drivers.plugins import SimFault
from crtk_drivers.samples import JointState, Number, Pose, Value, Vector, Wrench, vector
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.health import Health

SMALL_ANGLE: Final = 0.1
"""rad: how far a joint goes at most from where it is in a small motion."""

SMALL_WAY: Final = 0.02
"""m: the same for a joint that slides."""

SMALL_SPEED: Final = 0.1
"""Share of its velocity limit at which a joint goes at most in a small motion."""

ROOM: Final = 0.9
"""Share of the room to the end of its range that a joint uses."""

RATIO: Final = "trajectory_j/set_ratio_v"
"""The command for the share of the velocity limits that moves use."""

PLACES: Final = 20
"""At which it is looked whether a way is free, before it is gone."""

LOOK_PERIOD: Final = 0.02

LONGEST_STEP: Final = 0.05
"""Seconds that the time of a stream goes on at most from one command to the next."""


class Tripped(CrtkError):
    """The watch has stopped the device."""


class Broken(CrtkError):
    """A procedure (enable, home, a move back) failed: the device is not used any more in this run."""


class Process(StrEnum):
    """A process that belongs to a device."""

    SIMULATOR = "simulator"
    DRIVER = "driver"


class Processes(Protocol):
    """The processes of one device, for tests that take one away."""

    def pid(self, which: Process) -> int:
        """Return its process id."""

    def kill_driver(self) -> None:
        """End the driver's process, and wait for that."""

    def revive_driver(self) -> tuple[Door, Door]:
        """Start the driver's process again; return two connections to it, one for the watch."""

    def start_client(self, command: str, home: Vector, speed: Vector, rate: float) -> None:
        """Start a process that streams; see `ClientOrder`."""

    def kill_client(self) -> None:
        """End that process as by ``kill -9``, and wait for that; nothing if there is none."""

    def inject(self, fault: str, **parameters: Any) -> None:
        """Begin a fault of the simulator."""

    def begin(self, fault: SimFault, **parameters: Any) -> None:
        """Let something happen to the simulated device, until `end`."""

    def end(self, fault: SimFault) -> None:
        """Let it end."""

    def load(self, wrench: Wrench) -> None:
        """Let a wrench act on the simulated sensor, in its frame, until the next one."""

    def pressing(self) -> float:
        """Return the N with which the fingers of the simulated gripper press on what they hold."""

    def put_relay(self) -> tuple[Door, Door, RelayProcess]:
        """Start the driver anew, at a relay to its device; return two connections, and the relay."""

    def take_relay(self) -> tuple[Door, Door]:
        """Start the driver anew, at its device; return two connections."""


def _is_in(point: Vector, box: BoxConfig) -> bool:
    return bool((point >= box.lower).all() and (point <= box.upper).all())


def paced(rate: float, seconds: float) -> Iterator[float]:
    """Yield the seconds of a motion since its begin, `rate` times a second; what is late is not made up for.

    After a pause it goes on from where it was, at most `LONGEST_STEP` further: the arm does not leap.
    """
    at, before = 0.0, time.monotonic()
    due = before
    while at < seconds:
        yield at
        due = max(due + 1.0 / rate, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
        now = time.monotonic()
        at += min(now - before, max(LONGEST_STEP, 1.0 / rate))
        before = now


class Bed:
    """One device under test.

    Args:
        name: in the lab.
        about: the device.
        door: to it.
        watch: of it.
        thorough: 1 for a quick run, more for one that takes its time: how much is measured.
        processes: of the device; None where they may not be touched.
        carrier: the device that carries it, where the acquisition is about both.
        operator: who presses its emergency stop; None if nobody does.
        features: what else stands in the lab, as the lab file says.

    Attributes:
        kept: what was written down by `keep`.
    """

    def __init__(
        self,
        name: str,
        about: About,
        door: Door,
        watch: Watch,
        thorough: float,
        processes: Processes | None = None,
        carrier: Bed | None = None,
        operator: Operator | None = None,
        features: Mapping[str, bool | float | str] = MappingProxyType({}),
    ) -> None:
        self.features = features
        self.name = name
        self.about = about
        self.thorough = thorough
        self._door = door
        self._watch = watch
        self._slides: Vector | None = None
        self._processes = processes
        self._carrier = carrier
        self._operator = operator
        self.kept: dict[str, Any] = {}

    @property
    def carrier(self) -> Bed:
        """The device that carries it, which an acquisition with `carrier_needs` has."""
        assert self._carrier is not None
        return self._carrier

    # ------------------------------------------------------------------------------- what is written down

    def mark(self, text: str) -> None:
        """Make a mark in the recording."""
        self._door.call("mark", text)

    def note(self, **values: Any) -> None:
        """Write something down for the analysis, such as an amplitude."""
        self._door.call("note", json.dumps(values))

    def keep(self, **values: Any) -> None:
        """Write something down that outlives the driver's process."""
        self.kept |= values

    # -------------------------------------------------------------------------------------------- waiting

    def rest(self, seconds: float) -> None:
        """Let time pass.

        Raises:
            Tripped: the watch has stopped the device.
        """
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.check()
            time.sleep(min(left, LOOK_PERIOD))
        self.check()

    def wait_until(self, test: Callable[[Glance], bool], timeout: float) -> bool:
        """Wait for something that can be seen of the device; return whether it came in time."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            self.check()
            if test(self.glance()):
                return True
            time.sleep(LOOK_PERIOD)
        return False

    def check(self) -> None:
        """Raise `Tripped` if the watch has stopped the device, or does not look."""
        if self._watch.trouble:
            raise Tripped(self._watch.trouble)

    # ---------------------------------------------------------------------------------------- looking

    def glance(self) -> Glance:
        """Return how the device is."""
        found: Glance = self._door.call("glance")
        return found

    @property
    def position(self) -> Vector:
        """Joint positions (n,)."""
        value, _ = self.glance().values["measured_js"]
        assert isinstance(value, JointState)
        return value.position

    @property
    def setpoint(self) -> Vector:
        """Joint positions (n,) where it holds; those measured while it tells none."""
        values = self.glance().values
        value, stamp = values.get("setpoint_js", values["measured_js"])
        assert isinstance(value, JointState)
        return value.position if stamp.wall_ns and value.position.size else self.position

    @property
    def state(self) -> OperatingState:
        """Operating state."""
        return self.glance().status.state

    @property
    def notes(self) -> tuple[Note, ...]:
        """What the device tells of itself in words."""
        return self._health.notes

    @property
    def _health(self) -> Health:
        health: Health = self._door.call("health")
        return health

    @property
    def readings(self) -> Mapping[str, str]:
        """What the device tells of itself, by name; not what it does not know."""
        found: Mapping[str, str] = self._door.call("readings")
        return found

    def offers(self, *names: str) -> bool:
        """Whether the device has all of these CRTK names."""
        return all(name in self.about.commands for name in names)

    # ------------------------------------------------------------------------------------------- moving

    def command_state(self, text: str) -> Status:
        """Send a state command, and return the status that it led to."""
        if text != "disable":  # what was stopped is not powered again
            self.check()
        timeout = self.about.capabilities.transition_timeout
        with self._watch.during(text):
            status: Status = self._door.call("state_command", text, timeout, within=timeout)
        return status

    def enable(self) -> None:
        """Bring it to ENABLED, homed.

        Raises:
            Broken: it did not get there.
        """
        self._command_to("enable", OperatingState.ENABLED)
        if self.about.capabilities.needs_homing and not self.glance().status.is_homed:
            self._command_to("home", OperatingState.ENABLED)

    def disable(self) -> None:
        """Bring it to DISABLED.

        Raises:
            Broken: it did not get there.
        """
        self._command_to("disable", OperatingState.DISABLED)

    def home_again(self) -> None:
        """Let it forget its zero, and find it anew. It goes as it likes, and nothing is watched meanwhile.

        Raises:
            Broken: it did not.
        """
        with self._watch.during("homing"):
            for text in ("unhome", "home"):
                self._command_to(text, OperatingState.ENABLED)

    def service(self, name: str) -> str:
        """Ask for a service of the device's own, and return the answer."""
        self.check()
        timeout = self.about.capabilities.transition_timeout
        answer: str = self._door.call("service", name, timeout, within=timeout)
        return answer

    def submit(self, name: str, value: Value | None = None, stamp_ns: int = 0) -> None:
        """Send a CRTK command; see `Door.submit`."""
        self.check()
        self._door.submit(name, value, stamp_ns)

    def move_to(self, goal: Vector) -> None:
        """Move the joints to (n,) and wait for the end.

        Raises:
            Broken: it did not get there.
        """
        limits = self.about.capabilities.move_limits or self.about.capabilities.limits
        away = np.abs(goal - self.position)
        longest = 5.0 + 3.0 * max(
            float(d / limit.velocity + 2.0 * math.sqrt(d / limit.acceleration))
            for d, limit in zip(away, limits, strict=True)
        )
        refused = self._refused_moves
        self.submit("move_jp", JointState(position=goal))
        if not self.wait_until(lambda glance: not glance.status.is_busy, longest):
            raise Broken(f"a move did not end within {longest:.1f} s")
        if self.state is not OperatingState.ENABLED:
            raise Broken(
                f"a move ended in {self.glance().status.state}: {self.glance().status.cause}"
            )

        if self._refused_moves != refused:  # the device itself may, once it is told
            raise Broken(f"a move was refused: {self._health.last_refusal}")

    @property
    def _refused_moves(self) -> int:
        refusals = self._health.refusals.items()
        return sum(count for told, count in refusals if told.startswith("move_jp:"))

    @contextmanager
    def slowed(self, ratio: float) -> Iterator[None]:
        """Within, moves use a share of the velocity limits; all of them where the device knows no ratio."""
        if not self.offers(RATIO):
            yield
            return
        self.submit(RATIO, Number(ratio))
        try:
            yield
        finally:
            with suppress(CrtkError):
                self._door.submit(RATIO, Number(1.0))

    def stream(
        self,
        name: str,
        value: Callable[[float], Value],
        seconds: float,
    ) -> None:
        """Send a servo command again and again, each with the stamp of when it is sent.

        Args:
            name: of the command.
            value: of the seconds since the begin.
            seconds: for how long.
        """
        for t in paced(self.stream_rate, seconds):
            self.submit(name, value(t), time.time_ns())

    def insist(self, name: str, value: Callable[[float], Value], seconds: float) -> tuple[int, int]:
        """As `stream`, of what may be refused; return how many commands were sent, and refused."""
        sent = refused = 0
        for t in paced(self.stream_rate, seconds):
            sent += 1
            try:
                self.submit(name, value(t), time.time_ns())
            except Refused:
                refused += 1
        return sent, refused

    @property
    def stream_rate(self) -> float:
        """Commands a second of a stream: so few that a cycle takes one at most."""
        return min(100.0, self.about.capabilities.rate / 2.5)

    @property
    def slides(self) -> Vector:
        """Which joints slide (n,): 1, or 0 for one that turns. Without kinematics all turn."""
        if self._slides is None:
            jacobian = self._door.call("jacobian", self.position)
            turning = np.ones(self.position.size)
            if jacobian is not None:
                turning = np.linalg.norm(jacobian[3:], axis=0) > 1e-9
            self._slides = vector(1.0 - turning)
        return self._slides

    @property
    def lever(self) -> float:
        """How far the tool goes at most, in m, when one joint goes 1 rad (m); 0 without kinematics."""
        jacobian = self._door.call("jacobian", self.position)
        return 0.0 if jacobian is None else float(np.linalg.norm(jacobian[:3], axis=0).max())

    def reach(self, share: float = 1.0) -> Vector:
        """Return how far each joint (n,) may go either way in a small motion, from where it is set."""
        far = np.where(self.slides > 0.5, SMALL_WAY, SMALL_ANGLE) * share
        down, up = self.room()
        return vector(np.clip(np.minimum(far, np.minimum(down, up)), 0.0, None))

    def room(self) -> tuple[Vector, Vector]:
        """Return how far each joint (n,) may go downwards and upwards from where it is set."""
        limits = self.about.capabilities.limits
        here = self.setpoint
        lower = np.array([limit.lower for limit in limits])
        upper = np.array([limit.upper for limit in limits])
        return vector(ROOM * (here - lower)), vector(ROOM * (upper - here))

    def is_free(self, goal: Vector) -> bool:
        """Whether the joints may go straight to (n,), and the tool with them, as the lab file says."""
        here = self.setpoint
        limits = self.about.capabilities.limits
        within = (limit.lower <= at <= limit.upper for limit, at in zip(limits, goal, strict=True))
        if not all(within):
            return False
        box = self._watch.box
        if box is None:
            return True
        for share in np.linspace(0.0, 1.0, PLACES):
            pose = self.forward(vector(here + share * (goal - here)))
            if pose is None or not _is_in(pose.position, box):
                return False
        return True

    def forward(self, joints: Vector) -> Pose | None:
        """Return the tool pose of a joint position (n,); None without kinematics."""
        if not self.about.has_kinematics:
            return None
        pose: Pose = self._door.call("forward", joints)
        return pose

    def inverse(self, pose: Pose, near: Vector) -> Vector | None:
        """Return a joint position (n,) of a tool pose, near another one; None if it has none."""
        try:
            joints: Vector = self._door.call("inverse", pose, near)
        except Refused:
            return None
        return joints

    # -------------------------------------------------------------------------------------------- faults

    @contextmanager
    def expecting(self, what: str) -> Iterator[None]:
        """Within, the watch stops nothing: `what` is what the test is about."""
        with self._watch.during(what):
            yield

    @contextmanager
    def frozen(self, which: Process) -> Iterator[None]:
        """Within, a process gets no time: the simulator, as a device that falls silent, or the driver."""
        pid = self._own_processes.pid(which)
        watch = self._watch.paused() if which is Process.DRIVER else nullcontext()
        with watch, programs.frozen(pid):
            yield

    @contextmanager
    def client(self, command: str, home: Vector, speed: Vector) -> Iterator[None]:
        """Within, a process of its own streams; it is killed at the end. See `ClientOrder`."""
        processes = self._own_processes
        processes.start_client(command, home, speed, self.stream_rate)
        try:
            yield
        finally:
            processes.kill_client()

    @contextmanager
    def emergency_stop(self, stopped: Callable[[Glance], bool]) -> Iterator[Pressed]:
        """Within, the emergency stop is pressed, and the device was looked at until it was `stopped`.

        Raises:
            Broken: nobody is there to press it, or nobody did.
        """
        operator = self._operator
        if operator is None:
            raise Broken("nobody is there to press its emergency stop")
        begin = before = time.monotonic()
        limit = PERSON_TAKES if operator.is_person else UNNOTICED
        with pressed(operator):
            noticed, look = None, 0.0
            while noticed is None and before < begin + limit:
                self.check()
                is_stopped, now = stopped(self.glance()), time.monotonic()
                look, before = now - before, now
                noticed = now - begin if is_stopped else None
                time.sleep(STOP_LOOK_PERIOD)
            if noticed is None and operator.is_person:
                raise Broken(f"its emergency stop was not pressed within {limit:g} s")
            yield Pressed(noticed, look, operator.is_person)

    def inject(self, fault: str, **parameters: Any) -> None:
        """Begin a fault of the simulator.

        Raises:
            Broken: it has no such fault.
        """
        self._own_processes.inject(fault, **parameters)

    @contextmanager
    def happening(self, fault: SimFault, **parameters: Any) -> Iterator[None]:
        """Within, something happens to the device if it is simulated. What is real has it already.

        Raises:
            Broken: its simulator does not do that.
        """
        if self._processes is None:
            yield
            return
        self._processes.begin(fault, **parameters)
        try:
            yield
        finally:
            self._processes.end(fault)

    def load(self, wrench: Wrench) -> None:
        """Let a wrench act on the simulated sensor, in its frame, until the next one."""
        self._own_processes.load(wrench)

    def pressing(self) -> float | None:
        """Return the N with which simulated fingers press on what they hold; None of real ones."""
        return None if self._processes is None else self._processes.pressing()

    def kill_driver(self) -> None:
        """End the driver as by a power cut of its computer."""
        self._watch.close()
        self._own_processes.kill_driver()

    def revive_driver(self) -> None:
        """Start the driver again.

        Raises:
            CrtkError: it does not measure.
        """
        self._door, watching = self._own_processes.revive_driver()
        self._watch.start_again(watching)

    @contextmanager
    def through_relay(self) -> Iterator[RelayProcess]:
        """Within, the driver reaches its device through a relay; it is started anew for that, and afterwards.

        Raises:
            Broken: there is no link that a relay could cut.
            CrtkError: the driver does not measure through it.
        """
        processes = self._own_processes
        self._watch.close()
        self._door, watching, relay = processes.put_relay()
        self._watch.start_again(watching)
        try:
            yield relay
        finally:
            self._watch.close()
            self._door, watching = processes.take_relay()
            self._watch.start_again(watching)

    @property
    def _own_processes(self) -> Processes:
        if self._processes is None:
            raise Broken("its processes are not the bench's")
        return self._processes

    def _command_to(self, text: str, state: OperatingState) -> None:
        try:
            status = self.command_state(text)
        except CrtkError as error:
            self.check()
            raise Broken(f"{text}: {error}") from error
        if status.state is not state:
            raise Broken(f"{text} ended in {status.state}: {status.cause}")
