"""The contract between the core and a device: what a plugin implements, on one page.

A `Device` is the hardware side only. It validates nothing, keeps no state machine and starts no
thread: a `crtk_drivers.engine.Engine` drives it from the I/O thread of its bus and gives it
setpoints that are already checked and limited. Three rules make that safe:

* Only `read` may wait, and no longer than its deadline. Everything else returns at once.
* Nothing moves because of `open`; only `write`, `move` and `home` move the hardware, `enable` where
  `Capabilities.enable_moves` says so, and services that say so (`Service.moves`). All of that `stop` ends.
* The I/O thread alone calls a device, with these exceptions: `stop` and `left` come from the watchdog's
  thread too, `abort_open` from whoever shuts down, and `kinematics`, which are pure functions, from any.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from typing_extensions import override

from crtk_drivers.device.arm_kinematics import Kinematics
from crtk_drivers.device.capabilities import Capabilities
from crtk_drivers.device.extras import Input, Note, Reading, Service, Steps
from crtk_drivers.device.values import Condition, Goal, MoveProgress, Setpoint
from crtk_drivers.errors import CrtkError, DeviceFault, raise_first
from crtk_drivers.samples import Sample
from crtk_drivers.state import OperatingState


class Device(ABC):
    """One piece of hardware. The constructor takes the configuration and touches nothing."""

    @property
    @abstractmethod
    def capabilities(self) -> Capabilities:
        """What it can do; constant from construction on."""

    @property
    @abstractmethod
    def address(self) -> str:
        """Where it is, for messages: ``192.168.1.10:30004``, ``/dev/ttyUSB0``, ``can0 node 3``."""

    @property
    def bus(self) -> str:
        """Devices that return the same bus share one I/O thread."""
        return self.address

    @abstractmethod
    def open(self, deadline: float) -> None:
        """Connect, before the monotonic `deadline`. Nothing moves, no torque changes.

        Raises:
            ConnectionFailed: with the address and the remedy.
        """

    def abort_open(self) -> None:  # noqa: B027 - most devices open in no time
        """End an `open` that waits, at once, and let later ones fail: everything is being shut down.

        Override it where `open` may wait for longer than a second. The core calls it from another thread
        while the device is not open; an open one is told just before its last `close`.
        """

    def will_close(self) -> None:  # noqa: B027 - most hardware is left in one way only
        """Note that the driver ends: the last `stop` and `close` follow. From any thread; waits for nothing.

        Override it where they differ then from those after a lost link. The link is still to be used.
        """

    def wake(self) -> bool:
        """Let a `read` that waits for the hardware's clock return None at once. From any thread; never waits.

        Override it where `read` can: a command is then sent when it comes, not in the next cycle.

        Returns:
            whether it does.
        """
        return False

    @abstractmethod
    def close(self) -> None:
        """Release everything. May be called twice, and after a `ConnectionLost`.

        The core has called `stop` before and has waited for `has_stopped`. Where that could not be read back,
        what stops the hardware by itself stays armed. Hardware that can be left in more than one way is left
        as the key ``on_close`` of its configuration says (``hold`` or ``power_off``).
        """

    @abstractmethod
    def read(self, deadline: float) -> Sample | None:
        """Return the newest sample, or None if there is no new one by the monotonic `deadline`.

        Raises:
            ConnectionLost: the link is gone; the runtime closes and opens again.
        """

    @abstractmethod
    def write(self, setpoint: Setpoint) -> None:
        """Send one setpoint; its mode is one of the declared ones. Called while ENABLED only."""

    @abstractmethod
    def stop(self) -> None:
        """Stop any motion and hold, as fast as the hardware can do it smoothly.

        May be called from the watchdog's thread at any time, also while `read` waits: it must not
        take a lock that `read` holds.
        """

    def left(self) -> None:  # noqa: B027 - most do the same in all states
        """The core has left ENABLED without a procedure of the device: a fault of ours, a stream that ended;
        or `enable` or `resume` was broken off, or has failed.

        `stop` follows, and as that it may come from the watchdog's thread. Where the program ends while
        ENABLED it is not called: `close` follows then.
        """

    @property
    def has_stopped(self) -> bool:
        """Whether what `stop` asked for last has been read back from the hardware.

        That the joints stand is judged by the core from what is measured; this is for what it cannot see: the
        goal in a register, the mode of a drive. Where samples tell nothing valid of the joints, it alone
        counts. Until it is true the core goes on calling `stop`.
        """
        return True

    @property
    def found(self) -> str:
        """In what powered or moving state `open` found it: ``torque is on``, ``brakes are released``.

        Empty if it cannot move by itself. It is told as the detail of DISABLED.
        """
        return ""

    @property
    def takes_setpoints(self) -> bool:
        """Whether a setpoint written now takes effect at once.

        False after `stop`, while the hardware comes to rest: the core begins a stream after that.
        """
        return True

    @property
    def pace(self) -> float:
        """How fast the hardware goes along a trajectory of ours, of real time: 0 (stands) to 1.

        Below 1 where somebody slows it down, as with the speed slider of a teach pendant.
        """
        return 1.0

    @property
    def velocity_steps(self) -> tuple[float, ...]:
        """`Capabilities.velocity_resolution` as the connected hardware has it, where that tells it only then.

        Looked at after each `open`, for which joints stand.
        """
        return self.capabilities.velocity_resolution

    @property
    def has_arrived(self) -> bool:
        """Whether it rests where the last position setpoint is, as far as it can tell.

        False while hardware that smooths setpoints is still on its way: a move ends after that.
        """
        return True

    @property
    def condition(self) -> Condition:
        """What the last `read` said of the hardware."""
        return Condition()

    @property
    def is_taken_over(self) -> bool:
        """Whether somebody else commands it, so that what moves is theirs: the core sends no stop then.

        False from the moment at which `enable` or `resume` takes it back.
        """
        return False

    @property
    def obstacles(self) -> tuple[CrtkError, ...]:
        """What `enable` would raise now, as far as the last `read` says. ``crtk-driver check`` shows it.

        `enable` raises the first of these errors (`raise_first`), so that both judge alike. What `enable`
        removes by itself is no obstacle: a fault that it resets, an arm without power. No I/O; from any
        thread.
        """
        return ()

    @property
    def is_homed(self) -> bool:
        """Whether positions can be trusted; asked only if the capabilities need homing."""
        return True

    @property
    def kinematics(self) -> Kinematics | None:
        """Those with the tool and the calibration that count now; from any thread.

        Whether there are any is constant; the object is another one as soon as its answers would be.
        """
        return None

    @property
    def counters(self) -> Mapping[str, float]:
        """Numbers of its own for diagnostics (lost packages, retries, temperatures)."""
        return {}

    @property
    def counter_units(self) -> Mapping[str, str]:
        """Units of `counters` that have one, by the same names; constant.

        People see `s`, `Hz`, `N`, `N·m` and `B` as they are or with a prefix, and a `share` of 1 in percent.
        """
        return {}

    @property
    def notes(self) -> tuple[Note, ...]:
        """What people should know of it now, for diagnostics. No I/O; from any thread."""
        return ()

    @property
    def services(self) -> Mapping[str, Service]:
        """What it does beyond CRTK, by name (lower case, underscores); constant."""
        return {}

    @property
    def inputs(self) -> Mapping[str, Input]:
        """What it takes beyond CRTK, by name; constant."""
        return {}

    @property
    def readings(self) -> Mapping[str, Reading]:
        """What it tells beyond CRTK, by name, without `READINGS`; constant."""
        return {}

    @property
    def children(self) -> Mapping[str, Device]:
        """Devices with a state of their own behind it, by the name of their sub-namespace; constant.

        A gripper on an arm's bus, for example. They return the same `bus`, and are served after this device;
        or a bus of their own, which has a thread of its own.
        """
        return {}

    @property
    def followers(self) -> frozenset[str]:
        """Those of `children` without an operating state of their own, which follow this one's; constant."""
        return frozenset()

    def enable(self) -> Steps:
        """Power up and be ready for setpoints; the first one will be the measured position.

        Raises:
            CrtkError: the first of the `obstacles`, or what comes in the way later, and how to remove it.
        """
        raise_first(self.obstacles)
        yield from ()

    def disable(self) -> Steps:
        """Power down. Like `pause` and `home`, it begins after motion was stopped by `stop`."""
        yield from ()

    def pause(self) -> Steps:
        """Keep power, stop listening to setpoints."""
        yield from ()

    def resume(self) -> Steps:
        """Back from PAUSED."""
        yield from self.enable()

    def home(self) -> Steps:
        """Find the reference positions."""
        yield from ()

    def unhome(self) -> Steps:
        """Forget the reference positions."""
        yield from ()

    def free(self) -> Steps:
        """Let go, so that the arm may be moved by hand. Ended by `stop` or the next command."""
        yield from ()

    def use_gravity_compensation(self, on: bool) -> None:
        """Add the efforts that carry the arm's own weight to those that are sent, or leave them out."""
        raise NotImplementedError

    def move(self, goal: Goal) -> None:
        """Start the hardware's own motion to `goal`, from wherever it is and moves now."""
        raise NotImplementedError

    def move_progress(self) -> MoveProgress:
        """Say where the motion started last by `move` stands."""
        raise NotImplementedError


class Sensor(Device):
    """A device that measures and has nothing that moves: no command leads to `write`."""

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        """The fault of its `condition`: `enable` of a sensor only relies on it."""
        condition = self.condition
        if condition.allows is not OperatingState.FAULT:
            return ()
        remedy = "Remove the cause, and enable again."
        return (DeviceFault(condition.reason, where=self.address, remedy=remedy),)

    @override
    def write(self, setpoint: Setpoint) -> None:
        raise NotImplementedError

    @override
    def stop(self) -> None:
        """Nothing moves."""
