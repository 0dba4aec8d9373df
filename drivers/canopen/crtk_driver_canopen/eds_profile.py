"""From an EDS to a first drive profile: what is odd about a drive, and the table that says so."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Final

from crtk_driver_canopen.drive_profile import LONGEST_NAME, built_in
from crtk_driver_canopen.eds import DataSheet
from crtk_driver_canopen.identity import SERVO_PROFILE, Identity
from crtk_driver_canopen.modes import MODES, TARGETS, OpMode, supported
from crtk_driver_canopen.objects import OBJECTS, object_text
from crtk_driver_canopen.pdo import PREDEFINED, Direction
from crtk_driver_canopen.standard import EVERY, ROWS

_CYCLIC: Final = {
    OpMode.CSP: "position_offset",
    OpMode.CSV: "velocity_offset",
    OpMode.CST: "torque_offset",
}
"""An object that a drive has for the sake of each cyclic mode (CiA 402-2)."""

_FED_BACK: Final = ("statusword", "position_actual", "velocity_actual", "torque_actual")

_U32: Final = 0xFFFFFFFF
_NOT_VALID: Final = 1 << 31
_NO_RTR: Final = 1 << 30
_COASTS: Final = ("abort_connection_option", "quick_stop_option", "fault_reaction_option")

_OLD_FACTORS: Final = (0x6093, 0x6094, 0x6095)
"""Factors that DSP 402 had before CiA 402-2: of position, of the encoder of velocity, of velocity."""

_PER_SECOND: Final = frozenset({0x00B50300, 0})
"""60A9h of increments a second, and of a file that does not tell."""


class _Sheet:
    """The objects of a sheet by their names here."""

    def __init__(self, sheet: DataSheet) -> None:
        self._dictionary = sheet.dictionary
        self.path = sheet.path

    def variable(self, index: int, sub: int) -> object | None:
        """The library's variable; None if the drive has none."""
        found: object | None = self._dictionary.get_variable(index, sub)
        return found

    def has(self, name: str) -> bool:
        """Whether an object is there."""
        entry = OBJECTS[name]
        return self.variable(entry.index, entry.sub) is not None

    def default(self, index: int, sub: int) -> int | None:
        """Its default; None if there is no such object, or the file does not tell."""
        value = getattr(self.variable(index, sub), "default", None)
        return value if isinstance(value, int) else None

    def told(self, name: str) -> int | None:
        """The default of an object by name."""
        return self.default(OBJECTS[name].index, OBJECTS[name].sub)

    def constant(self, index: int, sub: int) -> bool:
        """Whether an object is there, and cannot be written."""
        variable = self.variable(index, sub)
        return variable is not None and not getattr(variable, "writable", True)

    @property
    def identity(self) -> Identity:
        """Who it is: 1018h, or [DeviceInfo] where that has no values."""
        about = self._dictionary.device_information
        return Identity(
            vendor=self.told("vendor_id") or getattr(about, "vendor_number", None),
            product=self.told("product_code") or getattr(about, "product_number", None),
            name=getattr(about, "product_name", None) or "",
        )


def oddities(sheet: DataSheet) -> list[str]:
    """Return what a drive has not, or has otherwise than CiA 402 says, with what follows from it."""
    objects = _Sheet(sheet)
    return [
        *_device(objects),
        *_missing(objects),
        *_modes(objects),
        *_units(objects),
        *_pdos(objects),
        *_options(objects),
    ]


def _device(objects: _Sheet) -> Iterator[str]:
    kind = objects.told("device_type")
    if kind and kind & 0xFFFF != SERVO_PROFILE:
        yield f"1000h tells device profile {kind & 0xFFFF}, not {SERVO_PROFILE}: it is no drive of CiA 402"
    for name, entry in OBJECTS.items():
        variable = objects.variable(entry.index, entry.sub)
        code = getattr(variable, "data_type", None)
        if variable is not None and entry.type.format and code != entry.type.value.code:
            yield f"{OBJECTS[name]} has another type (data type {code}) than {entry.type.name.lower()}"
    same = next((key for key, each in built_in().items() if each.is_of(objects.identity)), "")
    if same:
        yield f"there is a profile for it already, which is taken by itself: {same}"


def _missing(objects: _Sheet) -> Iterator[str]:
    modes = supported(objects.told("supported_drive_modes") or 0)
    for row in ROWS:
        if objects.has(row.name):
            continue
        refused = row.refused(row.used & modes)
        if row.needed == EVERY:
            yield f"no {row.entry}: this driver cannot use it"
        elif refused:
            elsewhere = f"; elsewhere {row.without}" if row.without else ""
            yield f"no {row.entry}: this driver cannot use it in {refused}{elsewhere}"
        elif row.without:
            yield f"no {row.entry}: {row.without}"


def hidden_modes(sheet: DataSheet) -> tuple[OpMode, ...]:
    """Return the modes that a drive may have by its objects, although its 6502h does not name them."""
    return _hidden(_Sheet(sheet))


def _hidden(objects: _Sheet) -> tuple[OpMode, ...]:
    word = objects.told("supported_drive_modes")
    if not word:
        return ()
    return tuple(
        mode
        for mode, offset in _CYCLIC.items()
        if mode not in supported(word) and objects.has(offset) and objects.has(TARGETS[mode])
    )


def _modes(objects: _Sheet) -> Iterator[str]:
    word = objects.told("supported_drive_modes")
    if word is None and objects.has("supported_drive_modes"):
        by_objects = [m.name.lower() for m, offset in _CYCLIC.items() if objects.has(offset)]
        may = ", ".join(by_objects) or "no cyclic mode"
        yield (
            f"6502h has no value in the file; by its objects it may have {may}: read it from the drive, "
            "which may tell fewer ('crtk-driver canopen scan')"
        )
    hidden = _hidden(objects)
    if hidden:
        names = ", ".join(mode.name.lower() for mode in hidden)
        yield f"6502h (0x{word:x}) does not name {names}, but their objects are there: try them, without load"
    elif word and not supported(word) & _CYCLIC.keys():
        yield f"6502h (0x{word:x}) names no cyclic mode (csp, csv, cst): it is driven by ip, pv, tq or pp"
    method = objects.told("homing_method")
    if method is not None and method != 0:
        yield f"homing method (6098h) is {method} from the factory"


def _units(objects: _Sheet) -> Iterator[str]:
    unit = objects.told("si_unit_velocity")
    if unit is not None and unit not in _PER_SECOND:
        what = "turns a minute" if unit == 0x00B44700 else "no increments a second"
        yield f"velocities are {what} (60A9h is 0x{unit:08x})"
    factors = [f"{index:X}h" for index in _OLD_FACTORS if objects.variable(index, 1) is not None]
    if factors:
        yield (
            f"it has factors of the old DSP 402 ({', '.join(factors)}), which scale what it counts and are "
            "left as they are: try, without load, how far and how fast it goes for one turn"
        )
    if objects.has("motor_rated_torque"):
        yield (
            "6076h tells the rated torque in mN·m by CiA 402; the file does not say whether this make does: "
            "compare it with the motor's, and give `rated_torque_unit`"
        )


def _pdos(objects: _Sheet) -> Iterator[str]:
    for direction, place in PREDEFINED.items():
        have = [n for n in range(4) if objects.variable(place.communication + n, 1) is not None]
        if len(have) < 4:
            yield f"{len(have)} {direction}s of the predefined ones, not 4"
        for number in have:
            yield from _pdo(objects, direction, number)
    receive = PREDEFINED[Direction.RECEIVE]
    if objects.variable(receive.communication, 1) is not None and (
        objects.variable(receive.communication, 5) is None
    ):
        yield "RPDOs have no deadline (14xxh:5): lost PDOs are seen by the following error, or not at all"
    targets = dict.fromkeys(TARGETS.values())
    for direction, names in (
        (Direction.RECEIVE, ("controlword", "mode_of_operation", *targets)),
        (Direction.TRANSMIT, ("mode_of_operation_display", *_FED_BACK)),
    ):
        for name in names:
            entry = OBJECTS[name]
            variable = objects.variable(entry.index, entry.sub)
            if variable is not None and not getattr(variable, "pdo_mappable", True):
                yield f"{entry} cannot be mapped into a {direction}"


def _pdo(objects: _Sheet, direction: Direction, number: int) -> Iterator[str]:
    place = PREDEFINED[direction]
    communication, mapping = place.communication + number, place.mapping + number
    name = f"{direction} {number + 1}"
    if objects.constant(mapping, 0) or objects.constant(mapping, 1):
        mapped = [
            object_text(value >> 16, value >> 8 & 0xFF)
            for sub in range(1, (objects.default(mapping, 0) or 0) + 1)
            if (value := objects.default(mapping, sub))
        ]
        yield f"the mapping of {name} is fixed: {', '.join(mapped) or 'nothing that the file tells'}"
    for sub, what in ((1, "COB-ID"), (2, "transmission type")):
        if objects.constant(communication, sub):
            yield f"the {what} of {name} is fixed: {objects.default(communication, sub)}"
    cob_id = objects.default(communication, 1)
    if cob_id is not None and cob_id & _NOT_VALID:
        yield f"{name} is off from the factory"
    if cob_id is not None and direction is Direction.TRANSMIT and cob_id & _NO_RTR:
        yield f"{name} has no remote request (bit 30 of its COB-ID), and may refuse to be without that bit"
    inhibit = objects.default(communication, 3)
    if direction is Direction.TRANSMIT and inhibit:
        yield f"{name} has an inhibit time of {inhibit / 10:g} ms from the factory, which is set to 0"


def _options(objects: _Sheet) -> Iterator[str]:
    for name in _COASTS:
        if objects.told(name) == 0:
            yield f"{OBJECTS[name]} is 0 from the factory: the motor coasts, or nothing is done"
    stays = objects.told("quick_stop_option")
    if stays in (5, 6, 7, 8):
        yield f"a quick stop (605Ah is {stays}) stays in quick stop active"
    ends = [objects.told(f"{end}_position_limit") for end in ("min", "max")]
    if ends[0] is not None and ends[0] == ends[1]:
        yield f"its position limits (607Dh) are both {ends[0]} from the factory: off"


def first_profile(sheet: DataSheet, odd: list[str]) -> str:
    """Return the TOML text of a first profile: what the EDS tells, and what is odd as notes.

    Args:
        sheet: of the drive.
        odd: see `oddities`.
    """
    objects = _Sheet(sheet)
    who = objects.identity
    lines = [
        f"# A first profile, after {_quoted(sheet.path)}. What it cannot tell is to be tried on the drive.",
        f"name = {_quoted(who.name[:LONGEST_NAME] or 'drive')}",
    ]
    names = [mode.name.lower() for mode in MODES if mode in _hidden(objects)]
    if names:
        lines.append(f"modes = {json.dumps(names)}    # not named by 6502h: to be tried")
    if not objects.has("home_offset"):
        lines.append('# home_position = {object = "INDEX:SUB", type = "i32"}')
    if not objects.has("encoder_increments"):
        lines.append('# increments = {object = "INDEX:SUB", type = "u32", factor = 4.0}')
    unit = _u32(objects.told("si_unit_velocity"))
    if unit:
        lines.append(f"velocity_unit = 0x{unit:08X}")
    lines.append("# rated_torque_unit = 1e-3    # N·m for one unit of 6076h")
    lines += ["notes = [", *(f"  {_quoted(each)}," for each in odd), "]", "", "[identity]"]
    product = _u32(who.product)
    lines.append(f"vendor = 0x{_u32(who.vendor):08X}")
    lines.append(f"products = [{f'0x{product:08X}' if product else ''}]")
    return "\n".join(lines) + "\n"


def _u32(value: int | None) -> int:
    """Return a number of a file; 0 if there is none, or if no object has room for it."""
    return value if value is not None and 0 <= value <= _U32 else 0


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
