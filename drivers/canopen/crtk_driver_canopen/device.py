"""CiA 402 drives on a CAN bus as one CRTK arm."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from typing_extensions import override

from crtk_driver_canopen.arm_link import ArmLink
from crtk_driver_canopen.arm_promises import capabilities_of
from crtk_driver_canopen.axis import Axis
from crtk_driver_canopen.bus_state import lost
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.homing import HomingPhase
from crtk_driver_canopen.layout import plan
from crtk_driver_canopen.motion import Motion
from crtk_driver_canopen.renewal import Renewal
from crtk_driver_canopen.statemachine import State, Status
from crtk_driver_canopen.stopping import leave_holding
from crtk_driver_canopen.troubles import AGAIN, Troubles
from crtk_driver_canopen.velocity_check import VelocityCheck
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    Goal,
    MoveProgress,
    Note,
    Setpoint,
    Severity,
    Steps,
)
from crtk_drivers.errors import ConnectionLost, CrtkError, TransitionFailed, raise_first
from crtk_drivers.kit import until
from crtk_drivers.samples import JointState, Sample, Value, vector
from crtk_drivers.state import OperatingState

logger = logging.getLogger(__name__)

LOST_TIME: Final = 0.25
"""Seconds in which no drive tells anything, after which the bus is opened anew; or `missed_cycles`."""

POWER_TIME: Final = 1.0
"""Seconds in which the drives lose their power at the end."""

REST_TIME: Final = 3.0
"""Seconds in which the joints come to rest after motion was stopped, by their measured positions."""


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
        self._capabilities = capabilities_of(config)
        self._condition = Condition()
        self._motion = Motion(config, self.link)
        self._patience = max(config.missed_cycles, math.ceil(LOST_TIME / config.period))
        self._troubles = Troubles(config, self.link, self._motion, self._patience)
        self._renewal = Renewal(config, self.link)
        self._transition = False
        self._checks: list[VelocityCheck] = []

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        nodes = ", ".join(map(str, self._config.nodes))
        return f"{self._config.bus.interface} {self._config.bus.channel} nodes {nodes}"

    @property
    @override
    def bus(self) -> str:
        return f"{self._config.bus.interface} {self._config.bus.channel}"

    @property
    def axes(self) -> list[Axis]:
        """The joints, while it is open."""
        return self.link.axes

    # ----------------------------------------------------------------------------------- life cycle

    @override
    def open(self, deadline: float) -> None:
        """Drives with power lose it once they stand, but those that were left holding."""
        self.link.open(deadline)
        self._transition = False
        self._condition = Condition()
        self._motion.begin()
        self._checks = [
            VelocityCheck(
                axis.config.velocity,
                step,
                self._config.period,
                abs(axis.facts.units.position),
                self._config.feedback_every,
            )
            for axis, step in zip(self.axes, self.link.units.velocity_steps, strict=True)
        ]
        if self.link.held:
            self._motion.begin_anew(time.monotonic())

    @override
    def abort_open(self) -> None:
        self.link.link.abort_open()

    @override
    def close(self) -> None:
        """Drives that have power are brought to rest, and left as `on_close` says.

        Those without power get back the limits of speed that they held before.
        """
        try:
            if self.link.is_live:
                is_safe = not any(axis.is_powered for axis in self.axes) or self._leave()
                if is_safe:  # else our heartbeat ends at once, and with it drives that go on
                    self.link.give_back_limits()
        except ConnectionLost as error:
            logger.warning(
                "%s: the drives are left to stop by themselves: %s", self.link.where, error
            )
        finally:
            self.link.close()

    def _leave(self) -> bool:
        """Stop the joints, then take the power from the drives or leave them holding.

        Where that they stand is not read back, they are told to stop quickly, and what stops them without us
        stays armed.

        Returns:
            Whether it was read back that they stand, and hold or have no power.

        Raises:
            ConnectionLost: the bus, or every drive on it, is gone.
        """
        waited = self._motion.stopping_for(time.monotonic())
        self._motion.stop()
        rest = self._capabilities.stop.time - waited
        stopped = self._run_until(lambda: self.has_stopped, max(0.0, rest))
        if stopped and self._config.on_close == "hold":
            leave_holding(self.link, self._config)
            return True
        for axis in self.axes:
            if axis.is_powered:
                axis.drive.request(State.DISABLED if stopped else State.QUICK_STOP)
        gone = self._run_until(lambda: not self._powered, POWER_TIME)
        is_safe = stopped and gone
        if not is_safe:
            unheard = [f"node {node}" for node in sorted(self._troubles.missing(time.monotonic()))]
            powered = ", ".join([*(axis.place for axis in self._powered), *unheard])
            logger.error(
                "%s: closed, and it was not read back that the joints stand and are without power%s; "
                "what stops the drives without us stays armed",
                self.link.where,
                f": {powered}" if powered else "",
            )
        return is_safe

    @property
    def _powered(self) -> list[Axis]:
        """The axes that tell that they have power."""
        missing = self._troubles.missing(time.monotonic())
        return [axis for axis in self.axes if axis.is_powered and axis.config.node not in missing]

    def _run_until(self, done: Callable[[], bool], seconds: float) -> bool:
        """Go on with the cycle; return whether it came to be so in time."""
        period = self._config.period
        deadline = time.monotonic() + seconds
        while not done():
            began = time.monotonic()
            if began > deadline:
                return False
            self.read(began + 2.0 * period)
            time.sleep(max(0.0, began + period - time.monotonic()) * (not self._config.kernel_sync))
        return True

    @property
    @override
    def found(self) -> str:
        return "; ".join(self.link.found.values())

    @override
    def read(self, deadline: float) -> Sample | None:
        """A joint vector is whole or not there.

        Raises:
            BusLost: the bus cannot be used, or no drive answers.
        """
        link = self.link
        complete = link.exchange(deadline)
        link.follow()
        now = time.monotonic()
        unstopped = self._motion.unstopped(now)
        link.last_resort.step(unstopped, now)
        self._judge(unstopped, now)
        self._motion.step(now)
        if not complete:
            self._motion.note_unknown()
            for check in self._checks:
                check.forget()
        if link.age > self._patience:
            raise lost(link.where)
        if not complete:
            # The link is there, and the fault tells who is missing.
            nothing: Mapping[str, Value] = {}
            return Sample(link.stamp, nothing) if self._condition.reason else None
        state = self._state()
        self._motion.note(state.position, now)
        self._check_velocities(state)
        values: dict[str, Value] = {"measured_js": state}
        if self._motion.setpoint is not None:
            values["setpoint_js"] = JointState(position=self._motion.setpoint)
        return Sample(link.sampled, values)

    def _check_velocities(self, state: JointState) -> None:
        """Compare measured velocities with positions, until each joint has moved enough."""
        if not state.velocity.size or all(check.judged for check in self._checks):
            return
        time_of = self.link.sampled.monotonic
        for axis, check, position, velocity in zip(
            self.axes, self._checks, state.position.tolist(), state.velocity.tolist(), strict=True
        ):
            if axis.homing is not None:
                check.forget()  # positions may be set
            elif check.take(position, velocity, time_of) and not check.agrees:
                axis.notes.append(check.text())
                logger.warning("%s: %s: %s", self.link.where, axis.place, check.text())

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

    def _judge(self, unstopped: list[Axis], now: float) -> None:
        missing = self._troubles.missing(now)
        trouble = self._troubles.told(missing, unstopped, now)
        if not trouble:
            self._condition = Condition()
            return
        if not self._transition:
            self._troubles.group_policy(
                {*missing, *self.link.deaf}, begins=not self._condition.reason
            )
        if trouble != self._condition.reason:
            self._condition = Condition(OperatingState.FAULT, trouble)

    # -------------------------------------------------------------------------------------- motion

    @override
    def write(self, setpoint: Setpoint) -> None:
        """A setpoint of another kind begins with a change of mode."""
        self._motion.follow(setpoint, time.monotonic())
        self.link.send()

    @override
    def move(self, goal: Goal) -> None:
        """Each drive goes there by its own profile (profile position mode)."""
        self._motion.move(goal, time.monotonic())

    @override
    def move_progress(self) -> MoveProgress:
        return self._motion.progress()

    @override
    def stop(self) -> None:
        """From another thread the drives are told to stop quickly, until `enable`."""
        if self.link.is_live:
            self._motion.stop_at_once(time.monotonic())
            return
        self._motion.stop()
        if not self.link.link.owned:
            self.link.stop_quickly()

    @property
    @override
    def velocity_steps(self) -> tuple[float, ...]:
        return self.link.units.velocity_steps

    @property
    @override
    def has_stopped(self) -> bool:
        return self._motion.stopped

    @property
    @override
    def takes_setpoints(self) -> bool:
        return self._motion.takes_setpoints

    # ------------------------------------------------------------------------------------ transitions

    @property
    @override
    def condition(self) -> Condition:
        return self._condition

    @property
    @override
    def is_homed(self) -> bool:
        return all(axis.homed for axis in self.axes)

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        if not self.link.is_live:
            return ()
        return tuple(self._troubles.of_enabling(time.monotonic()))

    @override
    def enable(self) -> Steps:
        """Set up again what has started anew, clear faults, and give power, holding where it is."""
        self._transition = True
        self.link.master.silent = False
        self.link.forget_deafness()
        self.link.forget_quick_stop()
        try:
            yield from self._renewal.set_up_again(self._motion.rates.note_set_up)
            yield from self._rest()  # a ramp that follows a fault is not cut off
            self._motion.begin_anew(time.monotonic())
            yield from self._clear_faults()
            raise_first(self._troubles.astray())
            yield from self._renewal.give_limits(
                axis
                for axis, position in zip(self.axes, self.link.positions, strict=True)
                if axis.limits is not None and not axis.limits.hold(position)
            )
            self._motion.begin_anew(time.monotonic())
            for axis in self.axes:
                axis.drive.request(State.ENABLED)
            yield from self._reach(lambda axis: axis.is_enabled and axis.shows_mode)
            self._motion.hold_here()
        except BaseException:  # also when it is given up half-way: none gets power later
            for axis in self.axes:
                axis.drive.request(State.DISABLED)
            raise
        finally:
            self._transition = False

    @override
    def resume(self) -> Steps:
        """The drives have held all along."""
        yield from ()

    @override
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
        yield  # the cycle in which a stop is seen
        yield
        yield from until(lambda: self._motion.at_rest, REST_TIME)

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
            now = time.monotonic()
            missing = self._troubles.missing(now)
            failures = [f"{axis.place}: {axis.failure}" for axis in self.axes if axis.failure]
            failures += [f"node {node} does not get our PDOs" for node in sorted(self.link.deaf)]
            foreign = self.link.foreign.found(now)
            if foreign:
                failures.append(foreign)
            if not failures and not missing and all(map(done, self.axes)):
                return
            if failures or missing:
                told = [str(each) for each in self.link.master.emergencies.values()]
                raise TransitionFailed(
                    "; ".join([*failures, *missing.values(), *told]),
                    where=self.link.where,
                    remedy=AGAIN,
                )
            yield

    @override
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
            yield  # the position may come with a later SYNC than the end of homing
            yield
            self._troubles.check_home(axes)
            yield from self._renewal.give_limits(axes)
            for axis in axes:
                axis.homed = True
        finally:
            self._motion.end_homing(time.monotonic())
        while self._motion.changes:
            yield

    @override
    def unhome(self) -> Steps:
        """Positions of joints that can be homed do not count any more."""
        for axis in self.axes:
            axis.forget_home()
        yield from ()

    # ------------------------------------------------------------------------------------------- told

    @property
    @override
    def counters(self) -> Mapping[str, float]:
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
    @override
    def counter_units(self) -> Mapping[str, str]:
        return {"bus_load": "share"}

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        told = [
            Note(Severity.WARNING, axis.place, "warning (statusword bit 7)")
            for axis in self.axes
            if axis.drive.statusword & Status.WARNING
        ]
        told += [
            Note(Severity.WARNING, axis.place, text) for axis in self.axes for text in axis.notes
        ]
        told += [
            Note(Severity.WARNING, axis.place, "remote (bit 9) is 0: it may take no controlwords")
            for axis in self.axes
            if self.link.is_live and not axis.takes_controlwords
        ]
        return tuple(told)
