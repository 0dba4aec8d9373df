"""CiA 402 drives on a CAN bus as one CRTK arm."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Final

import numpy as np

from crtk_driver_canopen.arm_link import COLLECT, ArmLink, lost
from crtk_driver_canopen.axis import KINDS, Axis
from crtk_driver_canopen.config import CanopenConfig, JointConfig
from crtk_driver_canopen.homing import HomingPhase
from crtk_driver_canopen.layout import plan
from crtk_driver_canopen.statemachine import State, Status
from crtk_drivers.commands import Kind
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    JointLimits,
    Mode,
    Note,
    Setpoint,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import ConnectionLost, CrtkError, TransitionFailed
from crtk_drivers.samples import JointState, Sample, Value, Vector, vector
from crtk_drivers.state import OperatingState

__all__ = ["CanopenDevice"]

_JERK_TIME: Final = 0.1
"""Seconds in which a joint may reach its greatest acceleration, unless its jerk is configured."""

LOST_TIME: Final = 0.25
"""Seconds in which no drive tells anything, after which the bus is opened anew."""

MODE_TIME: Final = 2.0
"""Seconds in which all drives show a mode of operation."""

REST_TIME: Final = 3.0
"""Seconds in which the joints come to rest after motion was stopped, by their measured positions."""

_STILL: Final = 0.01
"""Part of the greatest velocity of a joint below which it counts as standing."""

_MODES: Final[Mapping[Mode, Kind]] = {
    Mode.JOINT_POSITION: Kind.POSITION,
    Mode.JOINT_VELOCITY: Kind.VELOCITY,
    Mode.JOINT_EFFORT: Kind.EFFORT,
}


class _Motion(StrEnum):
    """What the drives are told in each cycle."""

    HOLD = "hold"
    FOLLOW = "follow"
    BRAKE = "brake"
    CHANGE = "change"


class CanopenDevice(Device):
    """The joints of one bus.

    Args:
        config: of the arm.

    Raises:
        ConfigError: its PDOs do not fit the nodes or the bus.
    """

    def __init__(self, config: CanopenConfig) -> None:
        self._config = config
        layout = plan(config)
        self.link = ArmLink(config, layout)
        self._bus_load = layout.load.most
        self._patience = max(config.missed_cycles, math.ceil(LOST_TIME / config.period))
        self._capabilities = _capabilities(config)
        self._condition = Condition()
        self._stop = threading.Event()
        self._kind = Kind.POSITION
        self._motion = _Motion.HOLD
        self._setpoint: Setpoint | None = None
        self._speed = np.zeros(len(config.joints))
        self._changed_at = 0.0
        self._fault = ""
        self._transition = False
        self._moving = False
        self._before: Vector = vector(())
        self._still = np.zeros(len(config.joints))

    @property
    def capabilities(self) -> Capabilities:
        """See the base class."""
        return self._capabilities

    @property
    def address(self) -> str:
        """See the base class."""
        nodes = ", ".join(map(str, self._config.nodes))
        return f"{self._config.bus.interface} {self._config.bus.channel} nodes {nodes}"

    @property
    def bus(self) -> str:
        """See the base class."""
        return f"{self._config.bus.interface} {self._config.bus.channel}"

    @property
    def axes(self) -> list[Axis]:
        """The joints, while it is open."""
        return self.link.axes

    # ----------------------------------------------------------------------------------- life cycle

    def open(self, deadline: float) -> None:
        """See the base class. Drives that have power lose it: nothing of ours has given it."""
        self.link.open(deadline)
        self._fault = ""
        self._transition = False
        self._setpoint = None
        self._condition = Condition()
        self._stop.clear()
        self._still = np.array([self._least_motion(axis) for axis in self.axes])
        self._hold_here()

    def _least_motion(self, axis: Axis) -> float:
        """Return what a joint moves in a cycle at least, unless it stands and its last count flickers."""
        counts = 1.5 * abs(axis.facts.units.position)
        return max(_STILL * axis.config.velocity * self._config.period, counts)

    def close(self) -> None:
        """See the base class. Drives that hold go on until they miss our heartbeat."""
        self.link.close()

    def read(self, deadline: float) -> Sample | None:
        """See the base class. A joint vector is whole or not there.

        Raises:
            BusLost: the bus cannot be used, or no drive answers.
        """
        link = self.link
        complete = link.exchange(deadline)
        link.follow()
        now = time.monotonic()
        self._judge(now)
        self._move(now)
        if link.age * self._config.period > LOST_TIME:
            raise lost(link.where)
        if not complete:
            # The link is there, and the fault tells who is missing.
            nothing: Mapping[str, Value] = {}
            return Sample(link.stamp, nothing) if self._condition.reason else None
        state = self._state()
        self._note_motion(state.position)
        return Sample(link.stamp, {"measured_js": state})

    def _note_motion(self, positions: Vector) -> None:
        if positions.size == self._before.size:
            moved = np.abs(positions - self._before)
            self._moving = bool((moved > self._still).any())
        self._before = positions

    def _state(self) -> JointState:
        link, units = self.link, self.link.units
        velocities, torques = link.velocities, link.torques
        efforts = None if torques is None else units.efforts(torques)
        if efforts is not None and np.isnan(efforts).any():
            efforts = None
        return JointState(
            units.positions(link.positions),
            vector(()) if velocities is None else units.velocities(velocities),
            vector(()) if efforts is None else efforts,
        )

    # ------------------------------------------------------------------------------- what is wrong

    def _judge(self, now: float) -> None:
        missing = self._missing(now)
        trouble = self._trouble(missing)
        if not trouble:
            self._condition = Condition()
            return
        if not self._transition:
            self._group_policy(missing, begins=not self._condition.reason)
        if trouble != self._condition.reason:
            self._condition = Condition(OperatingState.FAULT, trouble)

    def _trouble(self, missing: Mapping[int, str]) -> str:
        link = self.link
        found = [self._fault] if self._fault else []
        for axis in self.axes:
            if axis.config.node in missing:
                continue  # what it said last is not what it is now
            emergency = link.master.emergencies.get(axis.config.node)
            told = f" ({emergency})" if emergency is not None else ""
            if axis.failure:
                found.append(f"{axis.place}: {axis.failure}{told}")
            elif axis.drive.state is State.FAULT:
                found.append(f"{axis.place} is in fault{told}")
        return "; ".join([*found, *(missing[node] for node in sorted(missing))])

    def _missing(self, now: float) -> dict[int, str]:
        """Return the nodes of which is not known what they do, with what is known."""
        link = self.link
        in_time = 1000 * COLLECT * self._config.period
        missing = {
            node: f"node {node} sends its PDOs too late: not within {in_time:.3g} ms of any SYNC"
            for node in link.tardy(self._patience)
        }
        late = link.late(self._config.missed_cycles)
        missing |= {node: f"node {node} does not send its PDOs" for node in late}
        missing |= {
            node: f"node {node} is not heard any more"
            for node in link.master.watch.lost(now)
            if node in self._config.nodes
        }
        missing |= {
            node: f"node {node} is not operational any more: it is set up again when the arm is enabled"
            for node in link.left
        }
        return missing | {
            node: f"node {node} has started anew: it is set up again when the arm is enabled"
            for node in link.restarted
        }

    def _group_policy(self, missing: Mapping[int, str], *, begins: bool) -> None:
        """One axis has a fault: when it begins, have the others do what is configured.

        A drive of which nothing is known stops: when it hears us again, it may not be where it was.
        """
        goal = {"quick_stop": State.QUICK_STOP, "disable": State.DISABLED}.get(
            self._config.on_joint_fault
        )
        for axis in self.axes:
            wanted = goal if begins else None
            if axis.config.node in missing and axis.drive.goal is State.ENABLED:
                wanted = State.QUICK_STOP
            if wanted is not None and axis.is_enabled:
                axis.drive.request(wanted)

    # -------------------------------------------------------------------------------------- motion

    def write(self, setpoint: Setpoint) -> None:
        """See the base class. A setpoint of another kind begins with a change of mode."""
        kind = _MODES[setpoint.mode]
        self._setpoint = setpoint
        if kind is not self._kind:
            self._use(kind, time.monotonic())
        elif self._motion in (_Motion.HOLD, _Motion.FOLLOW):
            self._motion = _Motion.FOLLOW
            self._take(setpoint)
        self.link.send()

    def stop(self) -> None:
        """See the base class."""
        self._stop.set()

    @property
    def takes_setpoints(self) -> bool:
        """See the base class."""
        return not self._stop.is_set() and self._motion in (_Motion.HOLD, _Motion.FOLLOW)

    def _take(self, setpoint: Setpoint) -> None:
        """Have the drives follow a setpoint of the mode they are in."""
        units, outputs, values = self.link.units, self.link.outputs, setpoint.values
        if self._kind is Kind.POSITION:
            outputs.position[:] = units.position_counts(values)
        elif self._kind is Kind.VELOCITY:
            outputs.velocity[:] = units.velocity_counts(values)
            self._speed = np.array(values)
        else:
            outputs.torque[:] = units.effort_counts(values)

    def _move(self, now: float) -> None:
        """Go on with a change of mode, or a stop."""
        if self._stop.is_set():
            self._stop.clear()
            self._setpoint = None
            if self._kind is Kind.VELOCITY:
                self._motion = _Motion.BRAKE
            elif self._kind is Kind.EFFORT:
                self._use(Kind.POSITION, now)
            elif self._motion is not _Motion.CHANGE:
                self._motion = _Motion.HOLD
        if self._motion is _Motion.BRAKE:
            self._brake(now)
        elif self._motion is _Motion.CHANGE:
            self._change(now)

    def _brake(self, now: float) -> None:
        """Slow down within the limits of acceleration, and hold the position where that ends."""
        limits = self._capabilities.limits
        steps = np.array([limit.acceleration for limit in limits]) * self._config.period
        self._speed = np.sign(self._speed) * np.maximum(np.abs(self._speed) - steps, 0.0)
        self.link.outputs.velocity[:] = self.link.units.velocity_counts(vector(self._speed))
        if not self._speed.any():
            self._use(Kind.POSITION, now)

    def _use(self, kind: Kind, now: float) -> None:
        """Change to the mode of a kind of setpoints, holding still."""
        self._kind, self._motion, self._changed_at = kind, _Motion.CHANGE, now
        self._hold_here()
        self._motion = _Motion.CHANGE
        for axis in self.axes:
            mode = axis.mode_for(kind)
            if mode is not None:
                axis.use(mode)

    def _change(self, now: float) -> None:
        outputs, positions = self.link.outputs, self.link.positions
        for index, axis in enumerate(self.axes):
            if not axis.shows_mode:
                outputs.position[index] = positions[index]
        if all(axis.shows_mode for axis in self.axes):
            waiting, self._setpoint = self._setpoint, None
            self._motion = _Motion.HOLD
            if waiting is not None and _MODES[waiting.mode] is self._kind:
                self._motion = _Motion.FOLLOW
                self._take(waiting)
        elif now - self._changed_at > MODE_TIME:
            self._motion = _Motion.HOLD
            slow = ", ".join(axis.place for axis in self.axes if not axis.shows_mode)
            self._fault = f"the mode of operation did not change: {slow}"

    def _hold_here(self) -> None:
        """Have the drives stay where they are, in whatever mode they are."""
        outputs = self.link.outputs
        outputs.position[:] = self.link.positions
        count = len(outputs.position)
        outputs.velocity[:] = [0] * count
        outputs.torque[:] = [0] * count
        self._speed = np.zeros(count)
        self._motion = _Motion.HOLD

    # ------------------------------------------------------------------------------------ transitions

    @property
    def condition(self) -> Condition:
        """See the base class."""
        return self._condition

    @property
    def is_homed(self) -> bool:
        """See the base class."""
        return all(axis.homed for axis in self.axes)

    def enable(self) -> Steps:
        """Set up again what has started anew, clear faults, and give power, holding where it is."""
        self._transition, self._fault, self._setpoint = True, "", None
        self._stop.clear()
        try:
            yield from self._set_up_again()
            yield from self._rest()  # a ramp that follows a fault is not cut off
            self._use(Kind.POSITION, time.monotonic())
            yield from self._clear_faults()
            self._use(Kind.POSITION, time.monotonic())
            for axis in self.axes:
                axis.drive.request(State.ENABLED)
            yield from self._reach(lambda axis: axis.is_enabled and axis.shows_mode)
            self._hold_here()
        except BaseException:  # also when it is given up half-way: none gets power later
            for axis in self.axes:
                axis.drive.request(State.DISABLED)
            raise
        finally:
            self._transition = False

    def resume(self) -> Steps:
        """The drives have held all along."""
        yield from ()

    def disable(self) -> Steps:
        """Take the power from the motors, or leave them holding, as configured."""
        if self._config.disable == "hold":
            return
        self._transition = True
        try:
            yield from self._rest()
            for axis in self.axes:
                axis.drive.request(State.DISABLED)
            yield from self._reach(lambda axis: not axis.is_enabled)
        finally:
            self._transition = False

    def _rest(self) -> Steps:
        """Wait until motion has come to its end: a drive that loses its power in motion coasts."""
        deadline = time.monotonic() + REST_TIME
        yield  # the cycle in which a stop is seen
        yield
        while self._motion in (_Motion.BRAKE, _Motion.CHANGE) or self._moving:
            if time.monotonic() > deadline:
                return
            yield

    def _set_up_again(self) -> Steps:
        link = self.link
        nodes = link.restarted | link.left | link.late(self._config.missed_cycles)
        if not nodes:
            return
        try:
            yield from link.set_up_again(nodes)
        except ConnectionLost:
            raise
        except CrtkError as error:
            raise TransitionFailed(
                error.message, where=error.where or link.where, remedy=error.remedy
            ) from error

    def _clear_faults(self) -> Steps:
        """Reset the faults that are there, once."""
        faults = (State.FAULT, State.FAULT_REACTION)
        faulty = [axis for axis in self.axes if axis.drive.state in faults or axis.failure]
        for axis in faulty:
            axis.drive.reset_fault()
        yield from self._reach(lambda axis: axis not in faulty or axis.drive.reached)

    def _reach(self, done: Callable[[Axis], bool]) -> Steps:
        """Wait until it is so for every axis.

        Raises:
            TransitionFailed: a drive does not follow, with why.
        """
        while True:
            missing = self._missing(time.monotonic())
            failures = [f"{axis.place}: {axis.failure}" for axis in self.axes if axis.failure]
            if not failures and not missing and all(map(done, self.axes)):
                return
            if failures or missing:
                told = [str(each) for each in self.link.master.emergencies.values()]
                raise TransitionFailed(
                    "; ".join([*failures, *missing.values(), *told]),
                    where=self.link.where,
                    remedy="Remove the cause, and enable again.",
                )
            yield

    def home(self) -> Steps:
        """Home every joint that has a method, all at once; the others stay where they are."""
        yield from self._rest()
        axes = [axis for axis in self.axes if axis.config.homing is not None]
        for axis in axes:
            axis.begin_homing()
        try:
            while not all(axis.homing is None or axis.homing.over for axis in axes):
                yield
            failures = [
                axis.homing.failure
                for axis in axes
                if axis.homing is not None and axis.homing.phase is not HomingPhase.DONE
            ]
            if failures:
                raise TransitionFailed(
                    "; ".join(failures),
                    where=self.link.where,
                    remedy="Look at switches and speeds.",
                )
            for axis in axes:
                axis.homed = True
        finally:
            for axis in axes:
                axis.cancel_homing()
                axis.end_homing()
            self._use(self._kind, time.monotonic())
        while self._motion is _Motion.CHANGE:
            yield

    def unhome(self) -> Steps:
        """Positions do not count any more, where homing is required."""
        for axis in self.axes:
            axis.forget_home()
        yield from ()

    # ------------------------------------------------------------------------------------------- told

    @property
    def counters(self) -> Mapping[str, float]:
        """See the base class."""
        counted, bus = self.link.counters, self.link.link.counters
        return {
            "missed_pdos": float(counted.missed),
            "late_pdos": float(counted.late),
            "short_pdos": float(counted.short),
            "sync_overruns": float(counted.overruns),
            "unsent_cycles": float(counted.unsent),
            "foreign_syncs": float(counted.foreign_syncs),
            "error_frames": float(bus.error_frames),
            "bus_off": float(bus.bus_off),
            "bus_load": self._bus_load,
        }

    @property
    def notes(self) -> tuple[Note, ...]:
        """See the base class."""
        told = [
            Note(Severity.WARNING, axis.place, "warning (statusword bit 7)")
            for axis in self.axes
            if axis.drive.statusword & Status.WARNING
        ]
        foreign = self.link.counters.foreign_syncs
        if foreign:
            text = f"{foreign} SYNCs of another producer: is there another master on the bus?"
            told.append(Note(Severity.ERROR, "bus", text))
        told += [
            Note(Severity.WARNING, axis.place, text)
            for axis in self.axes
            for text in axis.facts.notes
        ]
        return tuple(told)


def _capabilities(config: CanopenConfig) -> Capabilities:
    joints = config.joints
    modes = {
        mode
        for mode, kind in _MODES.items()
        if joints and all(_follows(joint, kind) for joint in joints.values())
    }
    timeout = config.heartbeat.ours_timeout
    unasked = [name for name, joint in joints.items() if joint.abort_option in (None, 0)]
    what = "each drive stops by itself when it misses our heartbeat" if timeout else "nothing"
    if timeout and unasked:
        what += f", but what is set in the drive decides for {', '.join(unasked)}"
    return Capabilities(
        joints=tuple(joints),
        limits=tuple(map(_limits, joints.values())),
        modes=frozenset(modes),
        needs_homing=any(j.homing is not None and j.homing.required for j in joints.values()),
        stops_between_modes=True,
        rate=1.0 / config.period,
        paced_by_stream=config.kernel_sync,
        writes_every_cycle=True,
        stop=StopPolicy(timeout, what),
    )


def _follows(joint: JointConfig, kind: Kind) -> bool:
    if kind is Kind.EFFORT and not joint.effort > 0.0:
        return False
    return any(mode in joint.op_modes for mode in KINDS[kind])


def _limits(joint: JointConfig) -> JointLimits:
    return JointLimits(
        lower=joint.lower,
        upper=joint.upper,
        velocity=joint.velocity,
        acceleration=joint.acceleration,
        jerk=joint.acceleration / _JERK_TIME if joint.jerk is None else joint.jerk,
        effort=joint.effort,
    )
