"""What faults do: to the wire of a bus, to its adapter, or to servos."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from crtk_sim_backends.dynamixel.injection import ALL, BEGIN, END
from crtk_sim_backends.dynamixel.line import Line
from crtk_sim_backends.dynamixel.servo import Servo
from crtk_sim_backends.faults import Fault, FaultError
from crtk_sim_backends.process import SimStartError

log = logging.getLogger(__name__)


class FaultEffects:
    """Begins and ends faults on buses.

    Args:
        lines: the buses.
    """

    def __init__(self, lines: Sequence[Line]) -> None:
        self._lines = lines
        self._hit: dict[int, list[Servo]] = {}  # by identity of the fault: ids may change meanwhile

    def check(self, fault: Fault) -> None:
        """Refuse what cannot be.

        Raises:
            FaultError: for a bus or a servo that does not exist, and bytes that are not hexadecimal.
        """
        try:
            bytes.fromhex(fault.parameters.get("data", ""))
        except ValueError as error:
            raise FaultError(f"{fault.kind}: data must be bytes in hexadecimal") from error
        number = fault.parameters["bus"]
        if number > len(self._lines):
            raise FaultError(f"{fault.kind}: there is no bus {number}, only {len(self._lines)}")
        if not self._servos(fault):
            ids = ", ".join(str(servo.number) for servo in self._line(fault).bus.servos)
            wanted = fault.parameters["id"]
            raise FaultError(f"{fault.kind}: no servo has the id {wanted} on bus {number}: {ids}")

    def begin(self, fault: Fault) -> None:
        """Let it begin."""
        if fault.kind == "unplug":
            self._line(fault).unplug()
        elif fault.kind in BEGIN:
            servos = self._servos(fault)
            for servo in servos:
                BEGIN[fault.kind](servo, fault.parameters)
            if fault.kind in END:
                self._hit[id(fault)] = servos
        else:
            self._line(fault).begin(fault)

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "unplug":
            try:
                self._line(fault).port.plug()
            except SimStartError as error:
                log.error("it stays unplugged: %s", error)
        elif fault.kind in END:
            for servo in self._hit.pop(id(fault)):
                END[fault.kind](servo, fault.parameters)
        else:
            self._line(fault).end(fault)

    def _line(self, fault: Fault) -> Line:
        line: Line = self._lines[fault.parameters["bus"] - 1]
        return line

    def _servos(self, fault: Fault) -> list[Servo]:
        wanted = fault.parameters.get("id", ALL)
        return [s for s in self._line(fault).bus.servos if wanted in (ALL, s.number)]
