"""Lets the simulated machine be like a real drive: the objects of its EDS, the machine's own behind them.

Objects, access, defaults, ranges and PDO mappings are the file's. What the file lacks and the machine needs
is there with the machine's defaults, out of reach of the bus. Where a value of the file would be none for the
machine (a mode that it does not have, a limit of 0 that stands for "not set"), the machine's own stays.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from crtk_sim_backends.canopen.dictionary import Key, Object, OfNode, Variable
from crtk_sim_backends.canopen.objects import (
    AXIS_STRIDE,
    COUNTS,
    MODES,
    MOST_AXES,
    VALID,
    axis,
    communication,
    pdo_parameters,
)
from crtk_sim_backends.canopen.pdo import DUMMIES, LONGEST, MAPPING, RECEIVE, TRANSMIT
from crtk_sim_backends.canopen.sheet import Sheet, read_sheet
from crtk_sim_backends.canopen.units import acceleration_factor, turns_factor
from crtk_sim_backends.options import ConfigError

_SERVO: Final = 0x0192  # device profile in 1000
_AXES: Final = range(0x6000, 0x6000 + MOST_AXES * AXIS_STRIDE)

_ALWAYS: Final = ((0x6040, 0), (0x6041, 0))
_OF_SEVERAL: Final = ((0x6060, 0), (0x6061, 0))
_OF_MODE: Final[Mapping[int, tuple[Key, ...]]] = {
    1: ((0x607A, 0), (0x6064, 0), (0x6081, 0), (0x6083, 0)),
    3: ((0x60FF, 0),),
    4: ((0x6071, 0),),
    6: ((0x6098, 0), (0x6099, 1), (0x6099, 2)),
    7: ((0x60C1, 1), (0x6064, 0)),
    8: ((0x607A, 0), (0x6064, 0)),
    9: ((0x60FF, 0),),
    10: ((0x6071, 0),),
}
"""Objects without which there is no CiA 402 axis, no choice of modes, or no such mode (CiA 402-2, by mode).

What is only told, such as the actual velocity, need not be there.
"""

_POSITIONS: Final = (0x6065, 0x6067)
_VELOCITIES: Final = (0x606D, 0x606F, 0x607F, 0x6081, 0x6099, 0x60F8)
_ACCELERATIONS: Final = (0x6083, 0x6084, 0x6085, 0x609A, 0x60C5, 0x60C6)
"""Objects whose defaults are made for the machine's own units."""

_ZERO_IS_UNSET: Final = (0x6065, 0x6072, 0x6073, 0x607F, 0x6080, 0x6081, 0x60E0, 0x60E1)


class StandIn(NamedTuple):
    """What the machine works with where the file allows values that it has no use for.

    Attributes:
        low, high: what it can work with.
        value: that it works with in place of any other.
    """

    low: int
    high: int
    value: int


@dataclass(frozen=True)
class Likeness:
    """A drive that is like the one of an EDS.

    Attributes:
        sheet: the EDS.
        objects: that can be reached.
        hidden: that the machine needs besides.
        modes: of operation of each axis.
        notes: what was not taken from the file.
        stand_ins: for values that the file allows.
    """

    sheet: Sheet
    objects: tuple[Object, ...]
    hidden: tuple[Object, ...]
    modes: tuple[frozenset[int], ...]
    notes: tuple[str, ...]
    stand_ins: Mapping[Key, StandIn]

    def objects_of(self, serial: int) -> list[Object]:
        """Objects that can be reached, with the serial number of one drive."""
        return [
            _numbered(entry, serial) if entry.index == 0x1018 else entry for entry in self.objects
        ]


def _numbered(identity: Object, serial: int) -> Object:
    if 4 not in identity.entries:
        return identity
    return replace(
        identity, entries={**identity.entries, 4: replace(identity.entries[4], default=serial)}
    )


def like(path: str, modes: frozenset[int] = frozenset(MODES)) -> Likeness:
    """Read the EDS of a real drive and fit the machine to it.

    Args:
        path: of the file.
        modes: of operation that the drive may have.

    Raises:
        ConfigError: it cannot be read, is not of a CiA 402 drive, or lacks what one needs; says what.
    """
    sheet = read_sheet(path)
    _check_device(sheet)
    axes = sum(0x6040 + AXIS_STRIDE * number in sheet.objects for number in range(MOST_AXES))
    notes = list(sheet.notes)
    missing: list[str] = []
    found = [_modes(sheet, number, modes, missing) for number in range(max(1, axes))]
    if missing:
        raise ConfigError(f"{path}: no CiA 402 drive can be made of it: {'; '.join(missing)}")
    machine = {entry.index: entry for entry in _machine(sheet, axes)}
    objects = {
        index: _merged(sheet, entry, machine.get(index), notes)
        for index, entry in sheet.objects.items()
    }
    objects |= _identified(sheet, objects)
    for number, has in enumerate(found):
        objects |= _with_modes(objects, number, has)
    objects |= _mapped(objects, notes)
    for number, has in enumerate(found):
        if len(has) == 1:  # it is in its one mode, whether it can be told to be or not
            choice = machine[0x6060 + AXIS_STRIDE * number]
            only = replace(choice.entries[0], default=next(iter(has)))
            machine[choice.index] = replace(choice, entries={0: only})
    hidden = tuple(_behind(entry, objects.get(index)) for index, entry in machine.items())
    return Likeness(
        sheet,
        tuple(objects.values()),
        tuple(entry for entry in hidden if entry.entries),
        tuple(found),
        tuple(f"{path}: {note}" for note in notes),
        dict(_stand_ins(machine.values())),
    )


def _stand_ins(machine: Iterable[Object]) -> Iterator[tuple[Key, StandIn]]:
    for entry in machine:
        for sub, ours in entry.entries.items():
            bounded = ours.low is not None or ours.high is not None
            if entry.index in _AXES and bounded and isinstance(ours.default, int):
                least, most = ours.type.limits
                low = least if ours.low is None else ours.low
                high = most if ours.high is None else ours.high
                yield (entry.index, sub), StandIn(low, high, ours.default)


def _check_device(sheet: Sheet) -> None:
    """Refuse what has no communication profile, or another device profile.

    Raises:
        ConfigError: with the object.
    """
    for index, what in ((0x1000, "device type"), (0x1018, "identity")):
        if index not in sheet.objects:
            raise ConfigError(
                f"{sheet.path}: there is no [{index:04X}] ({what}), as CiA 301 needs it"
            )
    entry = sheet.objects[0x1000].entries.get(0)
    kind = entry.default if entry is not None else 0
    if isinstance(kind, int) and kind and kind & 0xFFFF != _SERVO:
        raise ConfigError(
            f"{sheet.path}: [1000] says device profile {kind & 0xFFFF}, which is not CiA 402 (drives)"
        )


def _modes(
    sheet: Sheet, number: int, permitted: frozenset[int], missing: list[str]
) -> frozenset[int]:
    """Modes of an axis: those of 6502; where it says none, those whose objects are there."""
    offset = AXIS_STRIDE * number
    own = {(index - offset, sub) for index, entry in sheet.objects.items() for sub in entry.entries}
    lacks = [key for key in _ALWAYS if key not in own]
    told = sheet.objects.get(0x6502 + offset)
    word = told.entries[0].default if told is not None and 0 in told.entries else 0
    if isinstance(word, int) and word:
        modes = frozenset(mode for mode in MODES if word >> mode - 1 & 1)
        for mode in sorted(modes):
            lacks += [key for key in _OF_MODE[mode] if key not in own and key not in lacks]
    else:
        modes = frozenset(mode for mode, keys in _OF_MODE.items() if own.issuperset(keys))
    if len(modes) > 1:
        lacks += [key for key in _OF_SEVERAL if key not in own]
    if lacks:
        names = ", ".join(_text((index + offset, sub)) for index, sub in lacks)
        missing.append(f"it lacks {names}")
    elif not modes & permitted:
        missing.append(f"axis {number} has none of the modes {', '.join(MODES.values())}")
    wrong = _wrong_types(sheet, offset, modes)
    missing.extend(wrong)
    return modes & permitted


def _text(key: Key) -> str:
    index, sub = key
    return f"{index:04X}:{sub}" if sub else f"{index:04X}"


def _wrong_types(sheet: Sheet, offset: int, modes: Iterable[int]) -> Iterator[str]:
    """Tell of objects that have another type than CiA 402 gives them."""
    needed = {*_ALWAYS, *_OF_SEVERAL, *(key for mode in modes for key in _OF_MODE[mode])}
    ours = {
        (entry.index, sub): variable for entry in axis(0) for sub, variable in entry.entries.items()
    }
    for key, variable in sorted(ours.items()):
        theirs = sheet.objects.get(key[0] + offset)
        entry = theirs.entries.get(key[1]) if theirs is not None else None
        if entry is None or entry.type is variable.type:
            continue
        if key in needed or not entry.type.size:
            name = _text((key[0] + offset, key[1]))
            yield f"{name} has the type {entry.type.name}, not {variable.type.name}"


def _machine(sheet: Sheet, axes: int) -> Iterator[Object]:
    """Yield the objects that the machine needs, in the units of the file."""
    for entry in communication(axes, 0, 0, 0, 0, b"", b"", b"", pdos=0):
        if entry.index < 0x2000:
            yield entry
    for index in _pdos(sheet.objects):
        direction = "R" if index < TRANSMIT else "T"
        yield next(iter(pdo_parameters(index & ~0x1FF, direction, index & 0x1FF)))
    for number in range(axes):
        factors = _factors(sheet, AXIS_STRIDE * number)
        for entry in axis(number):
            factor = factors.get(entry.index - AXIS_STRIDE * number)
            yield entry if factor is None else _scaled(entry, factor)


def _pdos(objects: Mapping[int, Object]) -> list[int]:
    """Communication parameters of the PDOs that have a mapping."""
    return [
        index
        for base in (RECEIVE, TRANSMIT)
        for index in range(base, base + MAPPING)
        if index in objects and index + MAPPING in objects
    ]


def _factors(sheet: Sheet, offset: int) -> dict[int, float]:
    """How much greater the file's units are than the machine's, by object."""

    def default(index: int, sub: int, other: int) -> int:
        entry = sheet.objects.get(index + offset)
        value = entry.entries[sub].default if entry is not None and sub in entry.entries else 0
        return value if isinstance(value, int) and value else other

    counts = default(0x608F, 1, COUNTS) / default(0x608F, 2, 1)
    if 0x6092 + offset in sheet.objects:
        counts = default(0x6092, 1, COUNTS) / default(0x6092, 2, 1)
        counts /= default(0x6091, 1, 1) / default(0x6091, 2, 1)
    position = counts / COUNTS
    velocity = position * (turns_factor(default(0x60A9, 0, 0), counts) or 1.0)
    acceleration = velocity
    if 0x60AA + offset in sheet.objects:
        acceleration = position * (acceleration_factor(default(0x60AA, 0, 0), counts) or 1.0)
    return {
        0x608F: counts / COUNTS,
        0x6092: counts / COUNTS,
        **dict.fromkeys(_POSITIONS, position),
        **dict.fromkeys(_VELOCITIES, velocity),
        **dict.fromkeys(_ACCELERATIONS, acceleration),
    }


def _scaled(entry: Object, factor: float) -> Object:
    def scaled(sub: int, variable: Variable) -> Variable:
        fixed = entry.index % AXIS_STRIDE in (0x608F % AXIS_STRIDE, 0x6092 % AXIS_STRIDE)
        if (
            not isinstance(variable.default, int)
            or (sub != 1 and fixed)
            or variable.access == "const"
        ):
            return variable
        value = max(1, min(round(variable.default * factor), variable.type.limits[1]))
        return replace(variable, default=value)

    return replace(
        entry, entries={sub: scaled(sub, variable) for sub, variable in entry.entries.items()}
    )


def _merged(sheet: Sheet, entry: Object, machine: Object | None, notes: list[str]) -> Object:
    """The file's object, with what the machine can do with it."""
    if machine is None:
        return entry
    entries = {}
    for sub, theirs in entry.entries.items():
        ours = machine.entries.get(sub)
        if ours is not None and ours.type.size and theirs.type.size:
            theirs = _usable(
                entry.index, sub, theirs, ours, (entry.index, sub) in sheet.given, notes
            )
        entries[sub] = theirs
    if entry.index % AXIS_STRIDE == 0x607D % AXIS_STRIDE and entry.index in _AXES:
        ends = [entries[sub].default for sub in (1, 2) if sub in entries]
        if len(ends) == 2 and ends[0] == ends[1]:  # both 0: no limits
            entries |= {
                sub: replace(entries[sub], default=machine.entries[sub].default) for sub in (1, 2)
            }
    return replace(entry, entries=entries)


def _usable(
    index: int, sub: int, theirs: Variable, ours: Variable, given: bool, notes: list[str]
) -> Variable:
    """Their entry: of an axis with the range of the file (see `StandIn`), else with that of both."""
    result = theirs
    if index not in _AXES:
        low = max((bound for bound in (theirs.low, ours.low) if bound is not None), default=None)
        high = min((bound for bound in (theirs.high, ours.high) if bound is not None), default=None)
        result = replace(theirs, low=low, high=high)
    if isinstance(theirs.default, OfNode):
        return result
    place = 0x6000 + index % AXIS_STRIDE if index in _AXES else index
    value = theirs.default
    unset = place in _ZERO_IS_UNSET and value == 0
    out = isinstance(value, int) and not _within(value, ours)
    if given and out:
        notes.append(
            f"[{_text((index, sub))}] DefaultValue={value!r}: the simulated machine works with "
            f"{ours.default!r}"
        )
    return result if given and not unset else replace(result, default=ours.default)


def _within(value: int, variable: Variable) -> bool:
    low, high = variable.low, variable.high
    return (low is None or value >= low) and (high is None or value <= high)


def _identified(sheet: Sheet, objects: Mapping[int, Object]) -> dict[int, Object]:
    """1018 as [DeviceInfo] has it, where it has no values of its own."""
    identity = objects[0x1018]
    entries = dict(identity.entries)
    for sub, value in enumerate(sheet.identity, 1):
        if sub in entries and not entries[sub].default:
            entries[sub] = replace(entries[sub], default=value)
    return {0x1018: replace(identity, entries=entries)}


def _with_modes(
    objects: Mapping[int, Object], number: int, modes: frozenset[int]
) -> dict[int, Object]:
    """6502 and 6060 with the modes that there are."""
    offset = AXIS_STRIDE * number
    changed = {}
    if told := objects.get(0x6502 + offset):
        word = sum(1 << mode - 1 for mode in modes)
        changed[told.index] = replace(told, entries={0: replace(told.entries[0], default=word)})
    mode = objects.get(0x6060 + offset)
    if mode is not None and mode.entries[0].default not in modes:
        changed[mode.index] = replace(mode, entries={0: replace(mode.entries[0], default=0)})
    return changed


def _mapped(objects: Mapping[int, Object], notes: list[str]) -> dict[int, Object]:
    """PDOs whose default mapping cannot be are empty and do not exist until they are mapped anew."""
    changed: dict[int, Object] = {}
    for index in _pdos(objects):
        mapping = objects[index + MAPPING]
        why = _wrong_mapping(objects, mapping, "r" if index < TRANSMIT else "t")
        if not why or 0 not in mapping.entries:
            continue
        notes.append(f"[{index + MAPPING:04X}] {why}: the PDO is empty")
        count = replace(mapping.entries[0], default=0)
        changed[mapping.index] = replace(mapping, entries={**mapping.entries, 0: count})
        parameter = objects[index]
        cob_id = parameter.entries[1]
        off = (
            OfNode(cob_id.default.offset | VALID)
            if isinstance(cob_id.default, OfNode)
            else int(cob_id.default) | VALID
        )
        entries = {**parameter.entries, 1: replace(cob_id, default=off)}
        changed[index] = replace(parameter, entries=entries)
    return changed


def _wrong_mapping(objects: Mapping[int, Object], mapping: Object, direction: str) -> str:
    """Why a default mapping cannot be; empty if it can."""
    count = mapping.entries[0].default if 0 in mapping.entries else 0
    bits = 0
    for sub in range(1, int(count) + 1 if isinstance(count, int) else 1):
        if sub not in mapping.entries:
            return f"has no entry {sub}"
        entry = mapping.entries[sub].default
        assert isinstance(entry, int)
        index, part = entry >> 16, entry >> 8 & 0xFF
        target = objects[index].entries.get(part) if index in objects else None
        if target is None and direction == "r" and not part and index in DUMMIES:
            size = DUMMIES[index].size
        elif target is None or direction not in target.pdo:
            return f"maps {_text((index, part))}, which cannot be mapped"
        else:
            size = target.type.size
        if entry & 0xFF != 8 * size:
            return f"maps {entry & 0xFF} bits of {_text((index, part))}, which has {8 * size}"
        bits += entry & 0xFF
    return f"maps {bits} bits" if bits > LONGEST else ""


def _behind(machine: Object, reached: Object | None) -> Object:
    """What the machine has of an object that cannot be reached."""
    if reached is None:
        return machine
    entries = {s: v for s, v in machine.entries.items() if s not in reached.entries}
    return replace(machine, entries=entries)
