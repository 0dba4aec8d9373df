"""What all simulated tools have in common: who they are, their power, and the Compute Box before them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.modbus import ILLEGAL_ADDRESS, Refused, answer
from crtk_sim_backends.onrobot.config import SimConfig
from crtk_sim_backends.onrobot.models import MODELS
from crtk_sim_backends.page import Gauges

IDENTITY: Final = range(0x0600, 0x0619)
FIRMWARE: Final = (0x0104, 0x0105)
"""Of 0x0604 and 0x0605."""
BOX: Final = 63
NO_TARGET: Final = 11
"""Exception of a gateway behind which nothing answers."""
FUNCTIONS: Final = frozenset({3, 6, 16, 23})

KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind(
            "unpowered", "no supply: it is silent, and restarted when it is back", lasting=True
        ),
        FaultKind(
            "other_model",
            "it is replaced by another tool",
            {"model": Parameter(str, choices=tuple(MODELS))},
            lasting=True,
        ),
        FaultKind(
            "replaced",
            "it is replaced by one of the same model",
            {"serial": Parameter(str, "SIM0002")},
            lasting=True,
        ),
    )
}


class Tool(ABC):
    """One tool. Its registers are words by address; what is not told reads as 0 between those that are."""

    functions = FUNCTIONS
    kinds: Mapping[str, FaultKind] = KINDS

    def __init__(self, config: SimConfig) -> None:
        self._code = MODELS[config.model].code
        self._serial = config.serial
        self._found = self._code, self._serial
        self.powered = True
        self.writes = 0

    @property
    @abstractmethod
    def words(self) -> Mapping[int, int]:
        """What can be read, beside who it is."""

    @abstractmethod
    def take(self, address: int, words: tuple[int, ...]) -> None:
        """Take what was written; it raises `Refused` for registers that there are not."""

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Let time pass."""

    @abstractmethod
    def restart(self) -> None:
        """It has power again."""

    @abstractmethod
    def gauges(self) -> list[Gauges]:
        """What the page shows."""

    def heard(self) -> None:  # noqa: B027 - nothing follows from it
        """A request was understood: it has no watchdog."""

    def read(self, address: int, count: int) -> bytes:
        """Return the bytes of registers."""
        if address in IDENTITY:
            known: Mapping[int, int] = self._identity
            last = IDENTITY[-1]
        else:
            known = self.words
            last = max((key for key in known if key < IDENTITY[0]), default=-1)
        if not any(key <= address for key in known) or address + count - 1 > last:
            raise Refused(ILLEGAL_ADDRESS)
        return b"".join(
            (known.get(at, 0) & 0xFFFF).to_bytes(2, "big") for at in range(address, address + count)
        )

    @property
    def _identity(self) -> dict[int, int]:
        code, serial = self._found
        text = serial.encode().ljust(32, b"\0")
        words = dict.fromkeys(IDENTITY, 0)
        words |= {0x0600: code, 0x0604: FIRMWARE[0], 0x0605: FIRMWARE[1]}
        return words | {
            0x0609 + i: int.from_bytes(text[2 * i : 2 * i + 2], "big") for i in range(16)
        }

    def write(self, address: int, data: bytes) -> None:
        """Take the bytes of registers."""
        words = (int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2))
        self.take(address, tuple(words))
        self.writes += 1

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        given = fault.parameters
        acts: Mapping[str, Callable[[], object]] = {
            "unpowered": lambda: setattr(self, "powered", False),
            "other_model": lambda: setattr(
                self, "_found", (MODELS[given["model"]].code, "SIM0003")
            ),
            "replaced": lambda: setattr(self, "_found", (self._code, given["serial"])),
        }
        acts[fault.kind]()

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "unpowered":
            self.power_cycle()
        else:
            self._found = self._code, self._serial

    def power_cycle(self) -> None:
        """Its power was away for a moment."""
        self.powered = True
        self.restart()

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {"powered": self.powered, "writes": self.writes}


class ComputeBox:
    """Answers for itself, and for units that are not there, in Modbus TCP.

    Args:
        tool: that is mounted.
    """

    functions = FUNCTIONS

    def __init__(self, tool: Tool) -> None:
        self._tool = tool

    def answer(self, unit: int, request: bytes) -> bytes | None:
        """Return what is answered to a request."""
        if unit == BOX:
            return answer(self, request)
        return bytes((request[0] | 0x80, NO_TARGET))

    def read(self, address: int, count: int) -> bytes:
        """It tells nothing."""
        raise Refused(ILLEGAL_ADDRESS)

    def write(self, address: int, data: bytes) -> None:
        """2 in register 0 takes the tool's power away and gives it back."""
        if address or data != b"\0\2":
            raise Refused(ILLEGAL_ADDRESS)
        self._tool.power_cycle()
