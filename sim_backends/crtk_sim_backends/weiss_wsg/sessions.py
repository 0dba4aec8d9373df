"""Clients of a simulated gripper: what they ask for, how it is answered, and what goes wrong with that."""

from __future__ import annotations

import re
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from typing_extensions import override

from crtk_sim_backends.kit import Session
from crtk_sim_backends.weiss_wsg import models
from crtk_sim_backends.weiss_wsg.gripper import STATES, Gripper

Later = Callable[[float, Session, bytes], object]
"""Sends bytes to a session so many seconds from now."""


class _Client(ABC):
    """One client, in either protocol.

    Args:
        gripper: that it speaks to.
        later: sends what is no answer at once.
        minds: whether the gripper stops fast when it leaves without a goodbye.
    """

    def __init__(self, gripper: Gripper, later: Later, *, minds: bool) -> None:
        self.ended = False
        self._gripper = gripper
        self._later = later
        self._minds = minds
        self._rest = b""
        self._out: bytes | None = None
        self._updates: dict[str, list[Any]] = {}  # period, when due, only changes, last
        self._count = 0

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return what is answered at once."""
        self._out = b""
        self._rest += data
        for name, values in self._requests():
            self._obey(name, values)
        out, self._out = self._out, None
        return out

    def close(self) -> None:
        """The client is gone."""
        self._updates.clear()
        if self._minds:
            self._minds = False
            self._gripper.obey("FASTSTOP", (), lambda *_: None)

    def vanish(self) -> None:
        """Its connection ends, and the gripper minds nothing."""
        self.ended, self._minds = True, False

    def tick(self, now: float) -> bytes:
        """Return the updates that are due."""
        told = b""
        for name, update in self._updates.items():
            period, due, only_changes, last = update
            if now < due:
                continue
            update[1] = max(due + period, now)
            value = self._value(name)
            if not (only_changes and value == last):
                update[3] = value
                told += self._tell(name, value, update=True)
        return told

    def _value(self, name: str) -> float:
        width, speed, force = self._gripper.told_motion
        return {
            "POS": width,
            "SPEED": speed,
            "FORCE": force,
            "GRIPSTATE": self._gripper.told_grasping,
            "SYSFLAGS": self._gripper.told_flags,
        }[name]

    def _subscribe(self, name: str, period: float, *, only_changes: bool) -> None:
        self._updates.pop(name, None)
        if period:
            self._updates[name] = [period, 0.0, only_changes, None]

    def _obey(self, name: str, values: tuple[float, ...]) -> None:
        if self._strikes("deaf", name):
            return
        if self._strikes("refuse", name):
            self._answer(name, self._gripper.faults["refuse"]["status"])
        elif name == "BYE":
            self._minds = False
            self._answer(name, models.OK)
            self.ended = self._ends_with_goodbye
        else:
            self._gripper.obey(name, values, lambda *told: self._answer(name, *told))

    _ends_with_goodbye = False

    def _strikes(self, kind: str, name: str) -> bool:
        given = self._gripper.faults.get(kind)
        return given is not None and given["command"] in ("", name)

    def _answer(self, name: str, status: int, *values: float) -> None:
        if self._strikes("swallow", name):
            return
        self._count += 1
        data = self._written(name, status, *values)
        doubled = self._gripper.faults.get("doubled")
        if doubled is not None and self._count % doubled["every"] == 0:
            data += data
        seconds = self._gripper.faults.get("held", {}).get("seconds", 0.0)
        if self._out is None or seconds:
            self._later(seconds, self, data)
        else:
            self._out += data

    @abstractmethod
    def _requests(self) -> Iterator[tuple[str, tuple[float, ...]]]:
        """Yield the commands that have arrived; questions are answered at once."""

    @abstractmethod
    def _written(self, name: str, status: int, *values: float) -> bytes:
        """Return the answer to a command."""

    @abstractmethod
    def _tell(self, name: str, value: float, *, update: bool) -> bytes:
        """Return a value as it is told."""


# ------------------------------------------------------------------------------------ binary protocol

COMMANDS: Final[Mapping[int, tuple[str, str]]] = {
    0x07: ("BYE", ""),
    0x20: ("HOME", "B"),
    0x21: ("MOVE", "xff"),
    0x22: ("STOP", ""),
    0x23: ("FASTSTOP", ""),
    0x24: ("FSACK", "xxx"),
    0x25: ("GRIP", "ff"),
    0x26: ("RELEASE", "ff"),
    0x30: ("SETACC", "f"),
    0x31: ("GETACC", ""),
    0x32: ("SETFORCE", "f"),
    0x33: ("GETFORCE", ""),
    0x34: ("SETLIMITS", "ff"),
    0x35: ("GETLIMITS", ""),
    0x36: ("CLEARLIMITS", ""),
}
"""Names and payloads, by number."""
LONGEST: Final = 1024
"""Bytes of a frame."""
NUMBERS: Final = {name: number for number, (name, _) in COMMANDS.items()}
TELLS: Final[Mapping[int, tuple[str, str]]] = {
    0x40: ("SYSFLAGS", "I"),
    0x41: ("GRIPSTATE", "B"),
    0x43: ("POS", "f"),
    0x44: ("SPEED", "f"),
    0x45: ("FORCE", "f"),
}
"""What is told, once or again and again, by number."""
NUMBER_OF: Final = {name: number for number, (name, _) in TELLS.items()}


def _crc_entry(index: int) -> int:
    value = index << 8
    for _ in range(8):
        value = (value << 1 ^ 0x1021) & 0xFFFF if value & 0x8000 else value << 1
    return value


CRC_TABLE: Final = [_crc_entry(index) for index in range(256)]


def frame(number: int, payload: bytes) -> bytes:
    """Return a frame (manual 1.2.1)."""
    data = b"\xaa\xaa\xaa" + bytes((number,)) + len(payload).to_bytes(2, "little") + payload
    return data + _crc(data).to_bytes(2, "little")


def _crc(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ CRC_TABLE[(crc ^ byte) % 256]
    return crc


class BinarySession(_Client):
    """A client of the binary protocol."""

    @override
    def _requests(self) -> Iterator[tuple[str, tuple[float, ...]]]:
        while len(rest := self._rest) >= 8:
            size = 8 + int.from_bytes(rest[4:6], "little")
            if rest[:3] != b"\xaa\xaa\xaa" or size > LONGEST:
                self._rest = rest[1:]
                continue
            if len(rest) < size:
                return
            self._rest, number, payload = rest[size:], rest[3], rest[6 : size - 2]
            if _crc(rest[:size]):
                self._reply(number, models.CHECKSUM)
            elif number in COMMANDS:
                yield from self._command(number, payload)
            else:
                self._question(number, payload)

    def _command(self, number: int, payload: bytes) -> Iterator[tuple[str, tuple[float, ...]]]:
        name, form = COMMANDS[number]
        wanted = struct.calcsize("<" + form)
        if len(payload) != wanted or (name == "FSACK" and payload != b"ack"):
            short = len(payload) < wanted
            self._reply(number, models.TOO_FEW if short else models.NO_PARAMETER)
            return
        yield name, struct.unpack("<" + form, payload)

    def _question(self, number: int, payload: bytes) -> None:
        model = self._gripper.model
        if number in TELLS and len(payload) == 3:
            name, _ = TELLS[number]
            how, period = struct.unpack("<BH", payload)
            self._subscribe(name, period / 1e3 if how else 0.0, only_changes=how == 2)
            if self._strikes("refuse", name):
                self._reply(number, self._gripper.faults["refuse"]["status"])
            else:
                self._put(self._tell(name, self._value(name), update=False))
        elif number == 0x53:
            limits = model.stroke, *model.speed, *model.acceleration, *model.force
            self._reply(number, models.OK, struct.pack("<8f", *limits))
        elif number == 0x50:
            self._reply(number, models.OK, struct.pack("<BBHI", 1, 2, 0x0400, 1234))
        elif number == 0x06:
            self._reply(number, models.OK, payload)
        elif number == 0x38:
            self._reply(number, 1)  # it has no sensor finger
        else:
            self._reply(number, models.FORMAT if number in TELLS else models.UNKNOWN)

    def _put(self, data: bytes) -> None:
        self._out = (self._out or b"") + data

    def _reply(self, number: int, status: int, data: bytes = b"") -> None:
        self._put(self._frame(number, status, data))

    def _frame(self, number: int, status: int, data: bytes) -> bytes:
        whole = frame(number, status.to_bytes(2, "little") + data)
        self._count += 1
        bad = self._gripper.faults.get("bad_crc")
        if bad is not None and self._count % bad["every"] == 0:
            whole = whole[:-1] + bytes((whole[-1] ^ 0x55,))
        return whole

    @override
    def _written(self, name: str, status: int, *values: float) -> bytes:
        return self._frame(NUMBERS[name], status, struct.pack(f"<{len(values)}f", *values))

    @override
    def _tell(self, name: str, value: float, *, update: bool) -> bytes:
        number = NUMBER_OF[name]
        form = TELLS[number][1]
        data = struct.pack("<" + form, value if form == "f" else int(value))
        return self._frame(number, models.OK, data)


# ------------------------------------------------------------------------------------------ text mode

CALL: Final = re.compile(r"([A-Z]+) *\((.*)\)")
QUESTION: Final = re.compile(r"([A-Z]+)(?:\[(\d+)\])?\?")
SETTING: Final = re.compile(r"([A-Z]+)=(.*)")
CALLS: Final = {*STATES, "STOP", "FASTSTOP", "FSACK", "BYE"}
DEFAULT_SPEED: Final = 100.0


class TextSession(_Client):
    """A client of the Gripper Control Language."""

    _ends_with_goodbye = True

    @override
    def _requests(self) -> Iterator[tuple[str, tuple[float, ...]]]:
        *lines, self._rest = self._rest.split(b"\n")
        for line in lines:
            text = line.decode("ascii", "replace").strip()
            if match := CALL.fullmatch(text):
                yield from self._call(match[1], match[2])
            elif match := QUESTION.fullmatch(text):
                self._question(match[1], match[2])
            elif match := SETTING.fullmatch(text):
                self._set(match[1], match[2])
            elif text:
                self._put(f"ERR {text.split('(')[0]} {models.UNKNOWN}")

    def _call(self, name: str, inside: str) -> Iterator[tuple[str, tuple[float, ...]]]:
        words = [word.strip() for word in inside.split(",") if word.strip()]
        if name == "AUTOSEND" and len(words) >= 2:
            self._autosend(words)
            return
        try:
            given = tuple(map(float, words))
        except ValueError:
            self._put(f"ERR {name} {models.FORMAT}")
            return
        if name not in CALLS or (name == "MOVE" and not given):
            self._put(f"ERR {name} {models.TOO_FEW if name in CALLS else models.UNKNOWN}")
        elif name == "GRIP":
            self._gripper.obey(
                "SETFORCE", given[:1] or (self._gripper.force_limit,), lambda *_: None
            )
            yield name, (given[1:] + (-1.0, DEFAULT_SPEED)[max(0, len(given) - 1) :])[:2]
        elif name == "RELEASE":
            by, speed = given[:2] + (5.0, DEFAULT_SPEED)[len(given) :]
            yield name, (self._gripper.width + by, speed)
        elif name in STATES:
            yield name, (*given, DEFAULT_SPEED)[:2] if name == "MOVE" else (*given, 0.0)[:1]
        else:
            yield name, ()

    def _autosend(self, words: list[str]) -> None:
        name = words[0].strip('"')
        if name not in ("POS", "SPEED", "FORCE", "GRIPSTATE"):
            self._put(f"ERR AUTOSEND {models.PARAMETER}")
            return
        changes = len(words) > 2 and words[2].lower() == "true"
        self._subscribe(name, float(words[1]) / 1e3, only_changes=changes)
        self._put("ACK AUTOSEND")

    def _question(self, name: str, index: str | None) -> None:
        if name == "SYSFLAGS" and index is not None and self._gripper.config.text_flags:
            self._put(f"SYSFLAGS[{index}]={self._gripper.told_flags >> int(index) & 1}")
        elif name in ("POS", "SPEED", "FORCE", "GRIPSTATE"):
            self._out = (self._out or b"") + self._tell(name, self._value(name), update=False)
        elif name == "CLT":
            self._put(f"CLT={self._gripper.travel:g}")
        else:
            self._put(f"ERR {name} {models.UNKNOWN}")

    def _set(self, name: str, text: str) -> None:
        if name == "CLT":
            self._gripper.travel = float(text)
        known = name in ("CLT", "PWT", "VERBOSE")
        self._put(f"{name}={text}" if known else f"ERR {name} {models.UNKNOWN}")

    def _put(self, line: str) -> None:
        self._out = (self._out or b"") + line.encode() + b"\n"

    @override
    def _written(self, name: str, status: int, *values: float) -> bytes:
        if status == models.PENDING or (status == models.OK and name not in STATES):
            return f"ACK {name}\n".encode()
        return (f"FIN {name}\n" if status == models.OK else f"ERR {name} {status}\n").encode()

    @override
    def _tell(self, name: str, value: float, *, update: bool) -> bytes:
        return f"{'@' if update else ''}{name}={value:g}\n".encode()
