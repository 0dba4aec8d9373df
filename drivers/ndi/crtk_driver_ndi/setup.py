"""From a tracker that somebody may have used before to one that is ready: the order that works everywhere.

Source: what scikit-surgerynditracker, PlusLib and sawNDITracker have in common; ndicapi issue 40 for freeing
handles first: a tool that a dead client has left initialised cannot be initialised again (ERROR13).
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from string import hexdigits
from typing import Final

from typing_extensions import override

from crtk_driver_ndi.codec import Reply
from crtk_driver_ndi.config import NdiConfig, ToolConfig
from crtk_driver_ndi.families import (
    FREQUENCIES,
    STEPS,
    TRACK_FREQUENCY,
    UNKNOWN,
    Family,
    family_named,
)
from crtk_driver_ndi.link import NdiLink, Refused
from crtk_driver_ndi.rom import LEAST_MARKERS, TYPES, read_rom
from crtk_drivers.errors import ConfigError, ConnectionFailed, ProtocolError

__all__ = [
    "ASK_STEP",
    "Identity",
    "PortInfo",
    "Prepared",
    "free",
    "handles_of",
    "identify",
    "prepare",
    "step_told",
]

logger = logging.getLogger(__name__)

ALL, TO_BE_FREED, NOT_INITIALISED, NOT_ENABLED = "00", "01", "02", "03"
"""What PHSR is asked for."""
ROUNDS: Final = 8
"""Times that PHSR:02 is asked: an Aurora tells of the next sensor of a tool when one is initialised."""
NOT_TRACKING: Final = frozenset({0x0C, 0x10, 0x11})
"""Errors of TSTOP where nothing was tracked."""

NO_DEFINITION: Final = frozenset({0x2C, 0x40})
"""Errors of PINIT where a tool has no sound definition in its memory."""
_NEEDS_DEFINITION: Final = (
    "; a tool without a definition of its own needs rom, beside port and channel"
)

ASK_STEP: Final = f"GET:{TRACK_FREQUENCY}"
"""What is asked before each start: another client may have set it since."""

_ENABLE_AS: Final[Mapping[int, str]] = {1: "S", 3: "B"}
"""Tracking priority by main type: static for a reference, button box; dynamic else."""

WORKS: Final = "Free it with the program that has it, or switch the tracker off and on."


@dataclass(frozen=True, slots=True)
class Identity:
    """What a tracker says that it is."""

    family: Family
    lines: tuple[str, ...]
    revision: str


@dataclass(frozen=True, slots=True)
class PortInfo:
    """What is behind a port handle.

    Attributes:
        handle: its number.
        kind: main type, see `crtk_driver_ndi.rom.TYPES`; 0 if it has none.
        manufacturer, serial_number, part_number: of the tool.
        port: where it is plugged in, from 1; 0 of a wireless one.
        channel: of it at that plug, from 0.
    """

    handle: int
    kind: int
    manufacturer: str
    serial_number: str
    part_number: str
    port: int = 0
    channel: int = 0

    @property
    def plug(self) -> str:
        """Where it is plugged in, in words."""
        return f"port {self.port}, channel {self.channel}" if self.port else "no port"

    def is_of(self, tool: ToolConfig) -> bool:
        """Whether all that a tool is named by fits."""
        wanted = {
            "part_number": tool.part_number or None,
            "serial_number": tool.serial_number or None,
            "port": tool.port,
            "channel": tool.channel,
        }
        return all(value in (None, getattr(self, key)) for key, value in wanted.items())

    @override
    def __str__(self) -> str:
        kind = TYPES.get(self.kind, f"type {self.kind:02X}")
        return (
            f"{kind} {self.part_number or 'without part number'} "
            f"(serial number {self.serial_number or 'unknown'}), by {self.manufacturer or 'nobody known'}"
            + (f", at {self.plug}" if self.port else "")
        )


@dataclass(slots=True)
class Prepared:
    """A tracker that is ready.

    Attributes:
        identity: of it.
        handles: of the tools, by their place in the configuration; without those that are not plugged in.
        infos: of all handles.
        problems: of handles that nobody asked for, in words.
    """

    identity: Identity
    handles: dict[int, int] = field(default_factory=dict)
    infos: dict[int, PortInfo] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def identify(link: NdiLink, deadline: float) -> Identity:
    """Ask a tracker what it is.

    Raises:
        ConnectionFailed, ConnectionLost: it does not say.
    """
    told = link.ask("VER:4", deadline).text
    lines = tuple(line.strip() for line in told.splitlines() if line.strip())
    try:
        revision = link.ask("APIREV:", deadline).text.strip()
    except Refused:  # older than this command
        revision = ""
    family = family_named(told)
    if family is UNKNOWN:
        logger.warning("%s: no family is known by %r", link.where, told[:80])
    return Identity(family, lines, revision)


def _set_frequency(link: NdiLink, wanted: int, deadline: float) -> None:
    """Set how many frames a second are taken, by the command that the tracker has.

    Raises:
        ConnectionFailed: it has none, or refuses.
    """
    value = FREQUENCIES[wanted]
    try:
        link.ask(f"SET:{TRACK_FREQUENCY}={value}", deadline)
    except Refused as refusal:
        try:
            link.ask(f"IRATE:{value}", deadline)
        except Refused:
            raise ConnectionFailed(
                f"track_frequency: {wanted} Hz cannot be set: {refusal.message}",
                where=link.where,
                remedy="Leave the key out: it takes frames then as it is set.",
            ) from refusal


def step_told(reply: Reply) -> int:
    """Return by how much frame numbers rise, by the reply to `ASK_STEP`; 0 if it does not say."""
    if reply.error is not None:  # older than this command
        return 0
    return STEPS.get(reply.text.rpartition("=")[2].strip(), 0)


def prepare(
    link: NdiLink,
    config: NdiConfig,
    tools: Sequence[ToolConfig],
    deadline: float,
    taken: set[int],
) -> Prepared:
    """Initialise a tracker and its tools.

    Args:
        link: to it.
        config: of it.
        tools: which are wanted.
        deadline: monotonic seconds.
        taken: gets the handles that are to be freed in the end, also where this fails.

    Raises:
        ConfigError: the definition of a tool cannot be read.
        ConnectionFailed: it or one of the tools refuses, with what to do.
        ConnectionLost: the link is gone.
    """
    try:
        link.ask("TSTOP:", deadline)
    except Refused as refusal:
        if refusal.code not in NOT_TRACKING:
            logger.info("%s", refusal)
    try:
        link.ask("INIT:", deadline)
        prepared = Prepared(identify(link, deadline))
        if config.volume is not None:
            link.ask(f"VSEL:{config.volume}", deadline)
        if config.track_frequency is not None:
            _set_frequency(link, config.track_frequency, deadline)
        for which in (TO_BE_FREED, ALL):
            for handle in _handles(link, which, deadline):
                link.ask(f"PHF:{handle:02X}", deadline)
    except Refused as refusal:
        raise ConnectionFailed(refusal.message, where=link.where, remedy=WORKS) from refusal
    for place, tool in enumerate(tools):
        if tool.is_wireless:
            prepared.handles[place] = _upload(link, tool, deadline, taken)
    _initialise(link, tools, prepared, deadline, taken)
    _enable(link, tools, prepared, deadline)
    return prepared


def _upload(link: NdiLink, tool: ToolConfig, deadline: float, taken: set[int]) -> int:
    """Let the tracker know a wireless tool, and return its handle."""
    count = len(read_rom(tool.rom).markers)
    if count < LEAST_MARKERS:
        raise ConfigError(
            f"{count} of the {LEAST_MARKERS} markers that a wireless tool needs",
            where=tool.rom,
            remedy=f"Give the port of the wired tool beside rom in {tool.namespace}.",
        )
    try:
        handle = int(link.ask("PHRQ:*********1****", deadline).text[:2], 16)
    except (Refused, ValueError) as error:
        refusal = _tool_refused(link, tool, error)
        refusal.remedy += " A wired tool without a definition of its own needs its port beside rom."
        raise refusal from error
    taken.add(handle)
    _write(link, tool, handle, deadline)
    return handle


def _write(link: NdiLink, tool: ToolConfig, handle: int, deadline: float) -> None:
    """Write a definition to a handle."""
    try:
        for address, data in read_rom(tool.rom).chunks:
            link.ask(f"PVWR:{handle:02X}{address:04X}{data.hex().upper()}", deadline)
    except Refused as error:
        raise _tool_refused(link, tool, error) from error


def _initialise(
    link: NdiLink,
    tools: Sequence[ToolConfig],
    prepared: Prepared,
    deadline: float,
    taken: set[int],
) -> None:
    written = {handle: tools[place] for place, handle in prepared.handles.items()}
    tried: set[int] = set()
    for _ in range(ROUNDS):
        found = [h for h in _handles(link, NOT_INITIALISED, deadline) if h not in tried]
        if not found:
            return
        for handle in found:
            tried.add(handle)
            if handle not in written:
                plugged = _info(link, handle, deadline)
                place = _written_to(plugged, tools, prepared)
                if place is not None:
                    _write(link, tools[place], handle, deadline)
                    written[handle], prepared.handles[place] = tools[place], handle
            taken.add(handle)
            try:
                link.ask(f"PINIT:{handle:02X}", deadline)
            except Refused as refusal:
                if handle in written:
                    raise _tool_refused(link, written[handle], refusal) from refusal
                hint = _NEEDS_DEFINITION if refusal.code in NO_DEFINITION else ""
                prepared.problems.append(f"{plugged.plug}: {refusal.message}{hint}")


def _written_to(plugged: PortInfo, tools: Sequence[ToolConfig], prepared: Prepared) -> int | None:
    """Return the place of the wired tool whose definition is to be written to a handle, if there is one."""
    for place, tool in enumerate(tools):
        is_ours = tool.rom and plugged.port and tool.port == plugged.port
        if is_ours and (tool.channel or 0) == plugged.channel and place not in prepared.handles:
            return place
    return None


def _enable(
    link: NdiLink, tools: Sequence[ToolConfig], prepared: Prepared, deadline: float
) -> None:
    for handle in _handles(link, NOT_ENABLED, deadline):
        info = prepared.infos[handle] = _info(link, handle, deadline)
        if handle not in prepared.handles.values():
            place = _named(info, tools, prepared)
            if place is not None:
                prepared.handles[place] = handle
    prepared.problems += _doubted(tools, prepared)
    for place, handle in prepared.handles.items():
        kind = prepared.infos[handle].kind if handle in prepared.infos else 0
        try:
            link.ask(f"PENA:{handle:02X}{_ENABLE_AS.get(kind, 'D')}", deadline)
        except Refused as refusal:
            raise _tool_refused(link, tools[place], refusal) from refusal


def _named(info: PortInfo, tools: Sequence[ToolConfig], prepared: Prepared) -> int | None:
    """Return the place of the tool that is behind a handle: that which is named most closely."""
    places = [
        place
        for place, tool in enumerate(tools)
        if not tool.rom and place not in prepared.handles and info.is_of(tool)
    ]
    return max(places, key=lambda place: len(_names_of(tools[place])), default=None)


def _names_of(tool: ToolConfig) -> list[object]:
    named = (tool.part_number, tool.serial_number, tool.port, tool.channel)
    return [each for each in named if each not in (None, "")]


def _doubted(tools: Sequence[ToolConfig], prepared: Prepared) -> Iterator[str]:
    """Tell of tools that become others when plugs change places."""
    for place, tool in enumerate(tools):
        fits = {info.port for info in prepared.infos.values() if info.is_of(tool)}
        if not tool.rom and place in prepared.handles and len(fits) > 1:
            ports = ", ".join(map(str, sorted(fits)))
            text = (
                f"{tool.namespace} may be what is at any of the ports {ports}: tools are exchanged with "
                "their plugs. Name it by serial_number, or by port"
            )
            logger.warning("%s", text)
            yield text


def free(link: NdiLink, taken: Iterable[int], deadline: float) -> None:
    """Free the handles of all tools: initialised ones cannot be initialised by another program.

    Raises:
        ConnectionFailed, ConnectionLost: the tracker does not answer by the monotonic `deadline`.
    """
    for handle in taken:
        try:
            link.ask(f"PHF:{handle:02X}", deadline)
        except Refused as refusal:  # unplugged since, or freed by another client
            logger.debug("%s", refusal)


def handles_of(text: str) -> dict[int, int]:
    """Return status by handle, of a reply to PHSR.

    Raises:
        ValueError: it is none.
    """
    count, rest = int(text[:2], 16), text[2:]
    if len(rest) != 5 * count:
        raise ValueError(f"{len(rest)} characters for {count} handles")
    pairs = (rest[at : at + 5] for at in range(0, len(rest), 5))
    return {int(pair[:2], 16): int(pair[2:], 16) for pair in pairs}


def _handles(link: NdiLink, which: str, deadline: float) -> Iterator[int]:
    text = link.ask(f"PHSR:{which}", deadline).text
    try:
        return iter(handles_of(text))
    except ValueError as error:
        raise ProtocolError(f"PHSR was answered with {text[:40]!r}", where=link.where) from error


def _info(link: NdiLink, handle: int, deadline: float) -> PortInfo:
    """Ask for options 0001, 0004 and 0020, whose answers follow one another.

    0001: type 8, manufacturer 12, revision 3, serial number 8, status 2. 0004: part number 20. 0020:
    device 8, system 1, 0 for a wired tool 1, port 2, channel 2.
    """
    try:
        text = link.ask(f"PHINF:{handle:02X}0025", deadline).text
    except Refused as refusal:
        logger.info("%s", refusal)
        text = ""
    digits, location = text[:2], text[62:67]
    is_wired = len(location) == 5 and location.isdigit() and location[0] == "0"
    return PortInfo(
        handle=handle,
        kind=int(digits, 16) if len(digits) == 2 and set(digits) <= set(hexdigits) else 0,
        manufacturer=text[8:20].strip(),
        serial_number=text[23:31].strip(),
        part_number=text[33:53].strip(),
        port=int(location[1:3]) if is_wired else 0,
        channel=int(location[3:5]) if is_wired else 0,
    )


def _tool_refused(link: NdiLink, tool: ToolConfig, error: Exception) -> ConnectionFailed:
    what = error.message if isinstance(error, Refused) else str(error)
    return ConnectionFailed(
        f"the tool {tool.namespace} cannot be used: {what}",
        where=link.where,
        remedy=f"Check {tool.rom or 'its plug'}, and that the tracker takes such a tool.",
    )
