"""The simulated drives at one line: what they hear, answer, and what goes wrong. No wire and no clock."""

from __future__ import annotations

import random
import re
from collections.abc import Mapping
from typing import Any, Final

from crtk_sim_backends.copley.config import SimConfig
from crtk_sim_backends.copley.drive import Drive, Refused
from crtk_sim_backends.faults import Fault, FaultKind, Parameter

FIRST_BAUD: Final = 9600
_BAUDS: Final = (9600, 19200, 38400, 57600, 115200)

_NODE: Final = Parameter(int, 0, minimum=0, maximum=15)
_EVERY: Final = Parameter(int, 1, minimum=1)
_TEXT: Final = Parameter(str, "g r0x32")


def _kind(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, parameters, lasting=True)


def _once(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, parameters)


KINDS: Final[dict[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        _once("reset", "a drive starts anew: all is as after power on", node=_NODE),
        _once("foreign_stop", "somebody else sends t 0", node=_NODE),
        _once("latch", "a fault is latched", node=_NODE,
              bit=Parameter(int, 7, minimum=0, maximum=31)),
        _once("lost_once", "the next command that has such a text is not heard", text=_TEXT),
        _once("mute_once", "the next command that has such a text is not answered", text=_TEXT),
        _once("wrong_digit", "a digit of the next point is another one"),
        _once("wrong_answer", "digits of the next answer to a command that has such a text are others",
              text=_TEXT),
        _kind("blocked", "a motor does not turn", node=_NODE),
        _kind("input_off", "an enable input is off", node=_NODE),
        _kind("status", "bits of the event status are set", node=_NODE,
              bits=Parameter(int, 1, minimum=0, maximum=0x7FFF_FFFF)),
        _kind("refuses", "commands that have such a text are refused", text=_TEXT,
              code=Parameter(int, 10, minimum=1, maximum=255)),
        _kind("deaf", "commands that have such a text are taken and do nothing", text=_TEXT),
        _kind("lost", "every n-th command is not heard", every=_EVERY),
        _kind("mute", "every n-th answer is not sent", every=_EVERY),
        _kind("half_line", "every n-th answer ends in the middle", every=_EVERY),
        _kind("corrupt", "a byte of every n-th answer is changed", every=_EVERY),
        _kind("garbled", "a byte of every n-th command is changed", every=_EVERY),
        _kind("doubled", "every n-th answer comes twice", every=_EVERY),
        _kind("garbage", "bytes of nobody stand before every n-th answer", every=_EVERY),
        _kind("late", "every n-th answer comes later by so many seconds", every=_EVERY,
              seconds=Parameter(float, 0.15, minimum=0.0, maximum=10.0)),
        _kind("node_gone", "a drive behind the first one is not there (e 32)", node=_NODE),
    )
}  # fmt: skip

_COMMAND: Final = re.compile(r"(?:(\d+) )?(?:\.([A-D]) )?(.*)")
_SET: Final = re.compile(r"s r(0x[0-9a-f]+|\d+)((?: -?(?:0x[0-9a-f]+|\d+))*)", re.IGNORECASE)
_GET: Final = re.compile(r"g r(0x[0-9a-f]+|\d+)", re.IGNORECASE)
_TRAJECTORY: Final = re.compile(r"t (0x[0-9a-f]+|\d+)", re.IGNORECASE)


class Drives:
    """All drives.

    Args:
        config: their options.
    """

    def __init__(self, config: SimConfig) -> None:
        self.kinds = KINDS
        self.config = config
        self.faults: dict[str, Mapping[str, Any]] = {}
        self._counts: dict[str, int] = {}
        self._once: list[Fault] = []
        self._random = random.Random(1)
        self.baud = FIRST_BAUD
        self.drives = [Drive(config, float(config.start)) for _ in range(config.nodes)]

    # Faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        kind = fault.kind
        drive = self._drive(fault)
        if kind == "reset":
            self._restart(drive)
        elif kind == "foreign_stop":
            drive.axis.abort()
        elif kind == "latch":
            drive.axis.fail(1 << fault.parameters["bit"])
        elif kind == "blocked":
            drive.axis.stuck = True
        elif kind == "input_off":
            drive.input_off = True
            drive.switch()
        elif kind == "status":
            drive.extra = fault.parameters["bits"]
        elif not KINDS[kind].lasting:
            self._once.append(fault)
        else:
            self.faults[kind] = fault.parameters
            self._counts[kind] = 0

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self.faults.pop(fault.kind, None)
        drive = self._drive(fault)
        if fault.kind == "blocked":
            drive.axis.stuck = False
        elif fault.kind == "input_off":
            drive.input_off = False
            drive.switch()
        elif fault.kind == "status":
            drive.extra = 0

    def _drive(self, fault: Fault) -> Drive:
        node: int = fault.parameters.get("node", 0)
        return self.drives[min(node, len(self.drives) - 1)]

    def _restart(self, drive: Drive) -> None:
        """As after power on; the motor goes on turning for a moment."""
        index = self.drives.index(drive)
        new = Drive(self.config, drive.axis.position)
        new.axis.velocity, new.axis.stuck = drive.axis.velocity, drive.axis.stuck
        new.input_off = drive.input_off
        self.drives[index] = new
        if index == 0:
            self.baud = FIRST_BAUD

    def place(self, counts: float = 0.0) -> None:
        """Start all drives anew with their axes at a place, as if somebody had turned them."""
        self._once.clear()
        for drive in list(self.drives):
            drive.axis.position, drive.axis.velocity = counts, 0.0
            self._restart(drive)

    def strikes(self, kind: str) -> bool:
        """Whether a fault strikes now."""
        if kind not in self.faults:
            return False
        self._counts[kind] += 1
        return bool(self._counts[kind] % self.faults[kind]["every"] == 0)

    def _strikes_once(self, kind: str, text: str) -> bool:
        for fault in self._once:
            if fault.kind == kind and fault.parameters.get("text", "0x115 ") in text:
                self._once.remove(fault)
                return True
        return False

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        axes = [drive.axis for drive in self.drives]
        return {
            "position": [axis.position for axis in axes],
            "counts": [axis.counts for axis in axes],
            "reference": [axis.reference for axis in axes],
            "velocity": [axis.velocity for axis in axes],
            "on": [axis.on for axis in axes],
            "mode": [axis.mode for axis in axes],
            "latched": [axis.latched for axis in axes],
            "points": [len(axis.points) for axis in axes],
            "baud": self.baud,
        }

    def points(self, node: int) -> list[float]:
        """Return the positions of all points that a drive has taken since its buffer was cleared."""
        return self.drives[node].axis.told

    def step(self) -> None:
        """One step of all axes."""
        for drive in self.drives:
            drive.axis.step()

    # The line

    def obey(self, line: str) -> bytes:
        """Carry out a line without its end; the answer, as it is on the line."""
        if self.strikes("lost") or self._strikes_once("lost_once", line):
            return b""
        echo = f"{line}\r".encode() if self.config.echo else b""
        if self.strikes("garbled") and line:
            place = self._random.randrange(len(line))
            line = line[:place] + chr(ord(line[place]) ^ 0x40) + line[place + 1 :]
        if self._strikes_once("wrong_digit", line):
            number = line.split()[-2]
            line = line.replace(f" {number} ", f" {int(number) + 7000} ")
        try:
            told = self._carry_out(line.strip())
        except Refused as refusal:
            told = f"e {refusal.args[0]}"
        except ValueError:
            told = "e 33"
        if told is not None and self._strikes_once("wrong_answer", line):
            kind, number, *rest = told.split()
            told = " ".join([kind, str(int(number) + 7000), *rest])
        if told is None or self.strikes("mute") or self._strikes_once("mute_once", line):
            return echo
        return echo + self._spoilt(f"{told}\r".encode())

    def _spoilt(self, answer: bytes) -> bytes:
        if self.strikes("corrupt"):
            place = self._random.randrange(len(answer))
            changed = bytes((answer[place] ^ 0x40,))
            answer = answer[:place] + changed + answer[place + 1 :]
        if self.strikes("half_line"):
            answer = answer[: len(answer) // 2]
        if self.strikes("doubled"):
            answer += answer
        if self.strikes("garbage"):
            answer = self._random.randbytes(4) + answer
        return answer

    def _carry_out(self, line: str) -> str | None:
        if not line:
            return None
        found = _COMMAND.fullmatch(line)
        if found is None:
            raise Refused(33)
        node, letter, command = int(found[1] or 0), found[2] or "A", found[3]
        if letter != "A":
            raise Refused(36)
        if node >= len(self.drives) or (
            "node_gone" in self.faults and node == self.faults["node_gone"]["node"] != 0
        ):
            raise Refused(32)
        for kind in ("refuses", "deaf"):
            if kind in self.faults and self.faults[kind]["text"] in line:
                if kind == "deaf":
                    return "ok"
                raise Refused(self.faults[kind]["code"])
        return self._command(self.drives[node], command)

    def _command(self, drive: Drive, command: str) -> str | None:
        if command == "r":
            self._restart(drive)
            return None
        if command in ("enc clear", "ldenc clear"):
            return "ok"
        if found := _GET.fullmatch(command):
            parameter = int(found[1], 0)
            return f"v {self.baud if parameter == 0x90 else drive.get(parameter)}"
        if found := _SET.fullmatch(command):
            values = [int(part, 0) for part in found[2].split()]
            if int(found[1], 0) == 0x90:
                return self._set_baud(values)
            drive.put(int(found[1], 0), values)
            return "ok"
        if found := _TRAJECTORY.fullmatch(command):
            drive.trajectory_command(int(found[1], 0))
            return "ok"
        raise Refused(33 if command[:1] in "sgt" else 3)

    def _set_baud(self, values: list[int]) -> str:
        if len(values) != 1 or values[0] not in _BAUDS:
            raise Refused(10)
        self.baud = values[0]
        return "ok"
