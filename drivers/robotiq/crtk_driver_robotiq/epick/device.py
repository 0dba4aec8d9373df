"""A Robotiq ePick by its registers: one joint, the vacuum at its cups in Pa below the surroundings.

A vacuum that is asked for is a grip, and 0 lets go. `move_jp` ends when something is held, or fails when
nothing is in time. A stop keeps what is held: nothing moves, and without vacuum it would fall.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Final

from typing_extensions import override

from crtk_driver_robotiq.activated import TURN, ActivatedHand, Turn
from crtk_driver_robotiq.epick.config import EpickConfig
from crtk_driver_robotiq.epick.faults import fault_of
from crtk_driver_robotiq.epick.registers import (
    RELEASE,
    SURROUNDING,
    Command,
    EpickRegisters,
    Status,
    level,
)
from crtk_driver_robotiq.epick.suction import Suction
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Capabilities,
    Condition,
    JointLimits,
    Mode,
    Reading,
    StopPolicy,
)
from crtk_drivers.kit import modbus_link
from crtk_drivers.kit.gripping import (
    HELD,
    Doing,
    Echo,
    Fault,
    GripperDevice,
    Measured,
)
from crtk_drivers.plugins import modbus_ways
from crtk_drivers.samples import Number, Value
from crtk_drivers.state import OperatingState

__all__ = ["EpickHand", "create"]

LEAST: Final = 1000.0
"""Pa: what it can be asked for, it counts in these; less lets go."""
SUDDEN: Final = 1e8
"""Pa/s: a vacuum is no motion, and has no speed to be limited or watched."""


def create(config: EpickConfig) -> GripperDevice:
    """Return the device; nothing is opened."""
    return GripperDevice(EpickHand(config), config.place, config.on_close)


class EpickHand(ActivatedHand[Command]):
    """One gripper. As with fingers, what it is asked for leaves rACT alone where it can."""

    drops = "reset it and activate it, which lets go of what it holds"
    hint = "Take its power away and give it back."

    def __init__(self, config: EpickConfig) -> None:
        super().__init__(config.activate)
        self._config = config
        self._given_up: Callable[[], bool] = lambda: False
        way = modbus_ways.transport_of(
            config, "robotiq-epick", lambda: self._given_up() and self._status is None
        )
        self._link = modbus_link.ModbusLink(
            EpickRegisters(), way, modbus_ways.framing_of(config), config.reply_timeout
        )
        self._suction = Suction()
        self._status: Status | None = None
        limits = JointLimits(0.0, config.most, SUDDEN, 1e3 * SUDDEN, 1e6 * SUDDEN, 0.0)
        self.capabilities = Capabilities(
            model="ePick",
            joints=(config.joint,),
            joint_units=("Pa",),
            limits=(limits,),
            modes=frozenset({Mode.JOINT_POSITION}),
            native_moves=frozenset({"move_jp"}),
            enable_moves=True,
            rate=config.rate,
            stop=StopPolicy(0.05, "keeps the vacuum, and what it holds; it has nothing that moves"),
            velocity_resolution=(SUDDEN,),
        )

    @property
    @override
    def where(self) -> str:
        return self._link.where

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return self._link.counters

    # ------------------------------------------------------------------------------------- the link

    @property
    @override
    def is_open(self) -> bool:
        return self._status is not None

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self._given_up = given_up
        self._status = self._pending = None
        self._activating = False
        self._suction.begin()
        self._keep(modbus_link.first_answer(self._link, deadline, given_up))

    @override
    def close(self, *, moves: bool) -> None:
        self._status = None
        self._link.close()

    @override
    def exchange(self, deadline: float) -> Measured | None:
        answer = self._link.exchange(self._pending, deadline)
        if answer is None:
            return None
        self._keep(answer)
        return Measured(answer.stamp, answer.status.vacuum, velocity=0.0)

    def _keep(self, answer: modbus_link.Answer[Command, Status]) -> None:
        status = answer.status
        if answer.delivered is not None:
            self._suction.delivered(answer.delivered, time.monotonic())
            if self._pending is answer.delivered:
                self._pending = None
        self._status, self._suction.offered = status, self._pending
        self._suction.see(status, answer.stamp.monotonic)
        if not status.ready and not self._activating:
            self._pending = None  # one that was reset would be activated by it, and let go

    # ---------------------------------------------------------------------------------- what it is told

    @override
    def order(self, mode: Mode, value: float, ratio: float) -> Command:
        config, least = self._config, max(value - self._config.hysteresis, LEAST)
        if value < LEAST:
            pressure, timeout, minimum = RELEASE, config.release_timeout, SURROUNDING
        elif config.mode == "automatic":
            pressure, timeout, minimum = 0, config.timeout, level(least)
        else:
            pressure, timeout, minimum = level(value), config.timeout, level(least)
        return Command(
            advanced=config.mode == "advanced",
            go=True,
            pressure=pressure,
            timeout=round(10.0 * timeout),
            minimum=minimum,
        )

    @override
    def go(self, order: Command, *, at_once: bool) -> None:
        status = self._status
        is_set = status is not None and status.goes and status.advanced is order.advanced
        self._pending = replace(order, only_goal=is_set)

    @override
    def halt(self, *, aside: bool) -> None:
        if self._pending is not None and self._pending.go:
            self._pending = None

    @override
    def let_go(self) -> None:
        self.go(self.order(Mode.JOINT_POSITION, 0.0, 1.0), at_once=True)

    @property
    @override
    def doing(self) -> Doing:
        return self._suction.doing

    @property
    @override
    def rests(self) -> bool:
        return True

    @property
    @override
    def has_reached(self) -> bool:
        return self.doing in HELD or self.doing is Doing.FREE

    @property
    @override
    def disobeys(self) -> bool:
        return self.doing in (Doing.NOTHING, Doing.LOST)

    # --------------------------------------------------------------------------------------- its state

    @property
    @override
    def fault(self) -> Fault | None:
        return None if self._status is None else fault_of(self._status)

    @property
    @override
    def _echo(self) -> Echo[Command]:
        return self._suction.echo

    @override
    def unfit(self, *, enabled: bool) -> Condition | None:
        if self._status is None or self._status.ready:
            return None
        return Condition(OperatingState.DISABLED, "it is not activated")

    @override
    def adopt(self) -> None:
        self._suction.echo.adopt()

    @override
    def _turns(self) -> Iterator[Turn]:
        if self.fault is not None or self._shows(lambda status: status.activated):
            is_reset = partial(self._shows, lambda status: not status.activated)
            yield Turn(Command(activate=False), is_reset, TURN, "be reset")
        is_ready = partial(self._shows, lambda status: status.ready)
        yield Turn(Command(), is_ready, TURN, "finish activation")

    def _shows(self, test: Callable[[Status], bool]) -> bool:
        return self._status is not None and test(self._status)

    # ------------------------------------------------------------------------------------ beyond CRTK

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        text = "at the cups, absolute, in Pa"
        return {"pressure": Reading(text, Payload.NUMBER, self._tell_pressure)}

    def _tell_pressure(self) -> Value | None:
        status = self._status
        return None if status is None else Number(1e3 * status.pressure)
