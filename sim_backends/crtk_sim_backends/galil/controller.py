"""The simulated controller: commands, errors, axes, records. No sockets."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from crtk_sim_backends.faults import Fault, FaultKind, Parameter
from crtk_sim_backends.galil.axis import ABORT, ENCODER, ST, Axis, Piece
from crtk_sim_backends.galil.config import SimConfig
from crtk_sim_backends.galil.models import MODELS, record
from crtk_sim_backends.kit.datagrams import STREAM, STREAM_KINDS, FaultyWay

LETTERS: Final = "ABCDEFGH"

_AXIS = Parameter(str, "A", choices=tuple(LETTERS))


def _kind(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, parameters, lasting=True)


KINDS: Final[dict[str, FaultKind]] = {
    **STREAM_KINDS,
    **{
        kind.name: kind
        for kind in (
            FaultKind("reset", "the controller starts anew: all is as after power on", {}),
            FaultKind("foreign_stop", "somebody else sends ST", {}),
            FaultKind("encoder_failure", "an encoder fails, and the axis stops (OA1)", {"axis": _AXIS}),
            _kind("blocked", "a motor does not turn", axis=_AXIS),
            _kind("no_records", "no data records are sent"),
            _kind("refuses", "a command is refused", command=Parameter(str, "PA"),
                  code=Parameter(int, 6, minimum=1, maximum=255)),
            _kind("deaf", "a command is taken and does nothing", command=Parameter(str, "DP")),
            _kind("deaf_to_stop", "ST is taken and does nothing"),
            _kind("motor_off", "a motor has no power whatever it is told", axis=_AXIS),
            _kind("amplifier", "the amplifier tells an error",
                  status=Parameter(int, 1, minimum=0, maximum=0xFFFF_FFFF)),
            _kind("mute", "commands are not answered"),
            _kind("half_line", "answers end before their end"),
            _kind("chatter", "a program writes a line now and then"),
        )
    },
}  # fmt: skip

_ASSIGNED: Final = re.compile(r"([A-Z]{2})([A-H])=(.*)", re.IGNORECASE)
_VARIABLE: Final = re.compile(r"([A-Za-z][A-Za-z0-9]{0,7})=(.*)")

_FIELDS: Final[Mapping[str, tuple[str, float, float]]] = {
    "SP": ("speed", 0, 22_000_000),
    "AC": ("acceleration", 1024, 1_073_740_800),
    "DC": ("deceleration", 1024, 1_073_740_800),
    "ER": ("error_limit", -1, 2_147_483_647),
    "OE": ("off_on_error", 0, 3),
    "LD": ("limits_off", 0, 3),
    "JG": ("jog", -22_000_000, 22_000_000),
    "PA": ("goal", -2_147_483_648, 2_147_483_647),
}
"""Commands that set a number of each axis: its field, least and greatest value."""

_TOLD: Final[Mapping[str, Callable[[Axis], float]]] = {
    "TP": lambda axis: axis.counts,
    "RP": lambda axis: round(axis.reference),
    "TE": lambda axis: round(axis.reference) - axis.counts,
    "TV": lambda axis: round(axis.velocity),
    "TT": lambda axis: axis.volts,
    "SC": lambda axis: axis.stop_code,
    "TS": lambda axis: 0x80 * axis.moving | 0x20 * (not axis.on),
}


class Refused(Exception):
    """A command is not taken; the argument is its error code."""


class Controller:
    """The controller.

    Args:
        config: its options.
    """

    def __init__(self, config: SimConfig) -> None:
        self.kinds = KINDS
        self.config = config
        self.model = MODELS[config.model]
        self.faults: dict[str, Mapping[str, Any]] = {}
        self._way = FaultyWay()
        self.restart: Callable[[], None] = lambda: None
        self.start()

    def start(self) -> None:
        """Be as after power on; the motors stay where they are."""
        config = self.config
        places = [axis.position for axis in getattr(self, "axes", ())]
        places = places or [float(config.start)] * config.axes
        self.axes = [
            Axis(config.travel, config.home_at, config.index_every, place) for place in places
        ]
        for axis in self.axes:
            axis.power(on=False)
            axis.define(axis.position)
        self.sample = 0
        self.error = 0
        self.variables: dict[str, float] = {}
        self.echo = config.echo
        self.period = 0  # samples between two records
        self.client: tuple[str, int] | None = None
        self.marks = False  # what programs write has its highest bits set (CW)

    # Faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        kind = fault.kind
        if kind in STREAM:
            self._way.begin(kind, STREAM[kind](fault.parameters))
        elif kind == "reset":
            self.start()
            self.restart()
        elif kind == "foreign_stop":
            for axis in self.axes:
                axis.stop(ST)
        elif kind == "encoder_failure":
            self._axis(fault).stop(ENCODER)
            self._axis(fault).power(on=False)
            self._axis(fault).stop_code = ENCODER
        elif kind == "blocked":
            self._axis(fault).stuck = True
        else:
            self.faults[kind] = fault.parameters
            if kind == "motor_off":
                self._axis(fault).power(on=False)

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._way.end(fault.kind)
        self.faults.pop(fault.kind, None)
        if fault.kind == "blocked":
            self._axis(fault).stuck = False

    def _axis(self, fault: Fault) -> Axis:
        return self.axes[min(LETTERS.index(fault.parameters["axis"]), len(self.axes) - 1)]

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {
            "position": [axis.position for axis in self.axes],
            "reference": [axis.reference for axis in self.axes],
            "velocity": [axis.velocity for axis in self.axes],
            "on": [axis.on for axis in self.axes],
            "mode": [axis.mode for axis in self.axes],
            "stop_code": [axis.stop_code for axis in self.axes],
            "sample": self.sample,
        }

    def place(self, counts: float = 0.0) -> None:
        """Start anew with all axes at a place, as if somebody had turned them."""
        for axis in self.axes:
            axis.position = counts
        self.start()
        self.restart()

    # Time

    def step(self) -> list[bytes]:
        """One sample; the records that are due."""
        self.sample += 1
        off = self.faults.get("motor_off")
        for letter, axis in zip(LETTERS, self.axes, strict=False):
            if off is not None and off["axis"] == letter and axis.on:
                axis.power(on=False)
            axis.step()
        if not self.period or self.sample % self.period or "no_records" in self.faults:
            return []
        return self._way.through([self.record()])

    def record(self) -> bytes:
        """The data record as it is now."""
        told = self.faults.get("amplifier")
        amplifier = 0 if told is None else told["status"]
        return record(self.model, self.axes, self.sample, self.error, amplifier)

    # Commands

    def obey(self, line: str) -> bytes:
        """Carry out a line, and return the answers to its commands."""
        return b"".join(self._answer(command.strip()) for command in line.split(";"))

    def _answer(self, command: str) -> bytes:
        echo = f"{command}\r\n".encode() if self.echo else b""
        try:
            told = self._carry_out(command)
        except Refused as refusal:
            self.error = refusal.args[0]
            return echo + b"?"
        except (ValueError, IndexError):
            self.error = 4
            return echo + b"?"
        if isinstance(told, bytes):
            return echo + told + b":"
        return echo + (f"{told}\r\n".encode() if told else b"") + b":"

    def _carry_out(self, command: str) -> str | bytes:
        if not command:
            return ""
        refuses = self.faults.get("refuses")
        if refuses is not None and command.startswith(refuses["command"]):
            raise Refused(refuses["code"])
        deaf = self.faults.get("deaf")
        if deaf is not None and command.startswith(deaf["command"]):
            return ""
        if command == "\x12\x16":
            return self.config.revision or self.model.revision
        if found := _ASSIGNED.fullmatch(command):
            return self._assign(found[1].upper(), self._one(found[2].upper()), found[3])
        if (found := _VARIABLE.fullmatch(command)) and command[:2] not in ("MG",):
            return self._variable(found[1], found[2])
        name, rest = command[:2], command[2:].strip()
        if name in _FIELDS:
            return self._fields(name, rest)
        if name in _TOLD:
            axes = [self._one(letter) for letter in rest] or self.axes
            return ", ".join(f"{_TOLD[name](axis):g}" for axis in axes)
        handler = getattr(self, f"_do_{name.lower()}", None)
        if handler is None:
            raise Refused(1)
        told: str | bytes = handler(rest) or ""
        return told

    def _one(self, letter: str) -> Axis:
        if letter not in LETTERS or LETTERS.index(letter) >= len(self.axes):
            raise Refused(90)
        return self.axes[LETTERS.index(letter)]

    def _named(self, rest: str) -> list[Axis]:
        return [self._one(letter) for letter in rest.replace(" ", "")] or self.axes

    def _by_axis(self, rest: str) -> Iterable[tuple[Axis, str]]:
        for letter, value in zip(LETTERS, rest.split(","), strict=False):
            if value.strip():
                yield self._one(letter), value.strip()

    def _fields(self, name: str, rest: str) -> str:
        told = []
        for axis, value in self._by_axis(rest):
            if value == "?":
                told.append(f"{getattr(axis, _FIELDS[name][0]):.0f}")
            else:
                self._set(name, axis, value)
        return ", ".join(told)

    def _set(self, name: str, axis: Axis, value: str) -> None:
        field, low, high = _FIELDS[name]
        number = float(value)
        if not low <= number <= high:
            raise Refused(6)
        if name in ("AC", "DC"):
            number -= number % 1024
        if name == "PA" and axis.moving and not axis.tracks:
            raise Refused(7)
        setattr(axis, field, int(number) if name in ("OE", "LD") else number)
        if name == "JG":
            axis.next = "jog"
        elif name == "PA":
            axis.next = "go"

    def _assign(self, name: str, axis: Axis, value: str) -> str:
        if name in _FIELDS:
            self._set(name, axis, value)
        elif name == "DP":
            if axis.moving:
                raise Refused(7)
            axis.define(float(value))
        elif name == "PV":
            way, velocity, samples = (float(part) for part in value.split(","))
            code = axis.add(Piece(way, velocity, int(samples)))
            if code or int(samples) % 2 or not 0 <= samples <= 2048:
                raise Refused(code or 6)
        else:
            raise Refused(1)
        return ""

    def _variable(self, name: str, value: str) -> str:
        if value in ("?", ""):
            if name not in self.variables:
                raise Refused(9)
            return f"{self.variables[name]:.4f}"
        self.variables[name] = float(value)
        return ""

    def _do_sh(self, rest: str) -> None:
        for axis in self._named(rest):
            if not axis.on:
                axis.power(on=True)

    def _do_mo(self, rest: str) -> None:
        axes = self._named(rest)
        if any(axis.moving for axis in axes):
            raise Refused(7)
        for axis in axes:
            axis.power(on=False)

    def _do_st(self, rest: str) -> None:
        if "deaf_to_stop" not in self.faults:
            for axis in self._named(rest):
                axis.stop(ST)

    def _do_ab(self, rest: str) -> None:
        for axis in self.axes:
            axis.stop(ABORT)

    def _do_bg(self, rest: str) -> None:
        for axis in self._named(rest):
            if code := axis.begin():
                raise Refused(code)

    def _do_bt(self, rest: str) -> None:
        for axis in self._named(rest):
            if code := axis.begin_pvt():
                raise Refused(code)

    def _do_pt(self, rest: str) -> None:
        for axis, value in self._by_axis(rest):
            if code := axis.track(on=value == "1"):
                raise Refused(code)

    def _do_hm(self, rest: str) -> None:
        for axis in self._named(rest):
            axis.next = "home"

    def _do_fi(self, rest: str) -> None:
        for axis in self._named(rest):
            axis.next = "index"

    def _do_eo(self, rest: str) -> None:
        self.echo = rest == "1"

    def _do_cw(self, rest: str) -> None:
        self.marks = rest == "1"

    def _do_tc(self, rest: str) -> str:
        code, self.error = self.error, 0
        return f"{code} error" if rest == "1" else f"{code}"

    def _do_qz(self, rest: str) -> str:
        model = self.model
        return f"{len(self.axes)}, {model.general}, {model.coordinated}, {30 + model.tail}"

    def _do_qr(self, rest: str) -> bytes:
        return self.record()

    def _do_dr(self, rest: str) -> None:
        raise Refused(133)  # not on this handle

    def _do_th(self, rest: str) -> str:
        return "IHA TCP PORT 23 TO IP ADDRESS 127,0,0,1 PORT 40000"

    def _do_mg(self, rest: str) -> str:
        if rest == "_TM":
            return f"{self.config.sample_time:.4f}"
        name, letter = rest[1:3].upper(), rest[3:4].upper()
        axis = self._one(letter)
        if not rest.startswith("_"):
            raise Refused(9)
        if name in _FIELDS:
            return f"{getattr(axis, _FIELDS[name][0]):.4f}"
        if name == "BG":
            return f"{axis.moving:.4f}"
        if name in _TOLD:
            return f"{_TOLD[name](axis):.4f}"
        raise Refused(9)

    def datagram(self, data: bytes, sender: tuple[str, int]) -> bytes:
        """Take a command from a UDP handle; DR sends records there."""
        command = data.decode("ascii", "replace").strip()
        if command.startswith("DR"):
            number = command[2:].strip() or "0"
            self.period = int(number) if number.isdigit() else 0
            self.client = sender if self.period else None
            return b":"
        return self.obey(command)

    def chatter(self) -> bytes:
        """What a program on the controller says by itself."""
        text = f"STATUS {random.randrange(10)}\r\n".encode()
        return bytes(byte | 0x80 for byte in text) if self.marks else text
