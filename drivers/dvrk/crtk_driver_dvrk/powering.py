"""How the motors of an arm get their power: relays, power, zero currents, amplifiers, each step read back.

Source: ``PowerOnSequence`` of mtsRobot1394.cpp in sawRobotIO1394, whose order this is.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Final

from crtk_driver_dvrk.arm import States
from crtk_driver_dvrk.drive import Drive
from crtk_driver_dvrk.motor_file import Motor
from crtk_driver_dvrk.registers import BoardState
from crtk_driver_dvrk.safeguards import of_boards
from crtk_drivers.device import Steps
from crtk_drivers.errors import DeviceFault, TransitionFailed
from crtk_drivers.kit.waiting_steps import until

STEP: Final = 2.0
"""Longest seconds of a step that is read back."""

_POWER: Final = 3.0
"""The same of that to the motors' voltage."""

_AGAIN: Final = 0.02
"""Seconds after which a step is asked for again that is not read back: a packet may be lost."""


class Powering:
    """Switches on.

    Args:
        drive: tells the boards.
        states: returns those of the newest reading.
        sampled: waits for some readings that are asked for from then on.
        where: the controller, for errors.
    """

    def __init__(
        self,
        drive: Drive,
        states: Callable[[], States],
        sampled: Callable[[int], Steps],
        where: str,
    ) -> None:
        self._drive = drive
        self._states = states
        self._sampled = sampled
        self._where = where

    def up(self, motors: tuple[Motor, ...]) -> Steps:
        """Switch on relays, then power, which comes through the chain of relays; then amplifiers.

        Raises:
            DeviceFault: a step is not read back, with the board and what to do.
            TransitionFailed: it was broken off.
        """
        drive = self._drive
        drive.begin()
        yield from self._switched(
            lambda: drive.switch(relay=True),
            lambda state: state.relay_closed,
            STEP,
            "its safety relay does not close",
            "Look at the safety chain and at the emergency stop.",
        )
        yield from self._switched(
            lambda: drive.switch(power=True),
            lambda state: state.power and state.voltage_good and not state.timed_out,
            _POWER,
            "its motors do not get their voltage",
            "Is the emergency stop released, the safety chain closed, and the power supply on?",
        )
        if not (yield from self._while_powering(lambda: drive.is_zero(self._states()), STEP)):
            raise DeviceFault(
                "boards do not tell that currents are zero",
                where=self._where,
                remedy="Does another program write them? End it.",
            )
        for motor in motors:
            yield from self._amplifier(motor)

    def _amplifier(self, motor: Motor) -> Steps:
        def is_on(state: BoardState) -> bool:
            trouble = of_boards(self._states())
            if trouble is not None:  # which ends it at once, and explains why no amplifier is on
                raise DeviceFault(trouble.words, where=self._where, remedy=trouble.remedy)
            return state.board != motor.board or state.axes[motor.axis].is_on

        yield from self._switched(
            lambda: self._drive.switch(amplifier=motor),
            is_on,
            STEP,
            f"the amplifier of axis {motor.axis} is not on",
            "Look at the motor and its cable; is the board's power good?",
        )

    def _switched(
        self,
        switch: Callable[[], None],
        is_done: Callable[[BoardState], bool],
        seconds: float,
        words: str,
        remedy: str,
    ) -> Steps:
        """Switch something on until all boards tell that it is."""
        last = 0.0

        def done() -> bool:
            nonlocal last
            if all(map(is_done, self._states().values())):
                return True
            if time.monotonic() - last >= _AGAIN:
                last = time.monotonic()
                switch()
            return False

        # What is told now may have been so before: what was read since counts.
        switch()
        yield from self._sampled(2)
        if (yield from self._while_powering(done, seconds)):
            return
        for number, state in self._states().items():
            if not is_done(state):
                text = f"board {number}: {words} within {seconds:g} s"
                raise DeviceFault(text, where=self._where, remedy=remedy)

    def _while_powering(
        self, condition: Callable[[], bool], seconds: float
    ) -> Generator[None, None, bool]:
        def done() -> bool:
            if not self._drive.is_powering:
                raise TransitionFailed("was broken off by a stop", where=self._where)
            return condition()

        return (yield from until(done, seconds))
