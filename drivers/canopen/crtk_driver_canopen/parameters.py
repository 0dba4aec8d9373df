"""Objects that a configuration wants written into a drive: from its DCF, and its `parameters`."""

from __future__ import annotations

import logging
from typing import Final

from crtk_driver_canopen import eds
from crtk_driver_canopen.eds import DataSheet
from crtk_driver_canopen.joint_config import JointConfig
from crtk_driver_canopen.objects import (
    OBJECTS,
    Entry,
    ObjectType,
    is_command,
    object_text,
    parse_object,
)
from crtk_driver_canopen.sdo import Sdo
from crtk_drivers.errors import ConfigError

logger = logging.getLogger(__name__)

_STANDARD: Final = {(entry.index, entry.sub): entry for entry in OBJECTS.values()}

_BY_SIZE: Final = {1: ObjectType.U8, 2: ObjectType.U16, 4: ObjectType.U32, 8: ObjectType.U64}

_OURS: Final = range(0x1000, 0x2000)
"""Communication objects: heartbeats and PDOs are those of this driver, whatever a DCF says."""


def write_parameters(sdo: Sdo, name: str, joint: JointConfig, notes: list[str]) -> None:
    """Write what the DCF of a joint says (ParameterValue), then its `parameters`, and read it back.

    Nothing that moves or powers a drive is written, nor what would change what it has stored.

    Args:
        sdo: of its axis.
        name: of the joint.
        joint: its configuration.
        notes: which lines of the DCF were left out, and what cannot be read back, in words.

    Raises:
        ConfigError: the EDS or DCF cannot be read, or an object is no whole number.
        ObjectIgnored, SdoAborted, SdoSilent, ProtocolError: the drive does not take a value.
    """
    sheet = eds.load(joint.eds, joint.node) if joint.eds else None
    unread: list[str] = []
    remedy = f"Correct the parameters of joint {name}, or its DCF."
    if sheet is not None:
        for repair in sheet.repairs:
            logger.info("joint %s: %s", name, repair)
        whole = Sdo(sdo.port)  # a DCF names the objects of every axis as they are
        left_out = [entry for entry, _ in sheet.values() if is_command(entry.index)]
        if left_out:
            lines = ", ".join(object_text(entry.index, entry.sub) for entry in left_out)
            notes.append(
                f"of {joint.eds} was not written, because it moves or powers the drive, or stores: {lines}"
            )
        for entry, value in sheet.values():
            if entry.index in _OURS or is_command(entry.index) or not isinstance(value, int):
                continue
            if not whole.ensure(entry, value, remedy):
                unread.append(object_text(entry.index, entry.sub))
    for text, value in joint.parameters.items():
        entry = _entry(sdo, name, text, sheet)
        if not sdo.ensure(entry, _fitting(entry, value), remedy):
            unread.append(object_text(entry.index, entry.sub))
    if unread:
        notes.append(
            f"written, but not read back, for they can only be written: {', '.join(unread)}"
        )


def _entry(sdo: Sdo, name: str, text: str, sheet: DataSheet | None) -> Entry:
    """Return the object of a text: its type is that of the EDS, of CiA 402, or of the size that it has."""
    index, sub = parse_object(text)
    known = (None if sheet is None else sheet.entry(index, sub)) or _STANDARD.get((index, sub))
    if known is not None and known.type.format:
        return known
    asked = Entry(index, sub, ObjectType.BYTES, "").on_axis(sdo.axis)
    size = len(sdo.port.upload(asked.index, asked.sub))
    kind = _BY_SIZE.get(size)
    if kind is None:
        raise ConfigError(
            f"{object_text(asked.index, sub)} has {size} bytes, which is no whole number",
            where=f"joints.{name}.parameters",
            remedy="Only objects that are whole numbers can be given here.",
        )
    return Entry(index, sub, kind, "parameter")


def _fitting(entry: Entry, value: int) -> int:
    """Return a negative value as the unsigned one of the same bits, where only the size is known."""
    unsigned = entry.type in _BY_SIZE.values()
    return value & ((1 << entry.type.bits) - 1) if unsigned and value < 0 else value
