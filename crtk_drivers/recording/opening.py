"""Opens a recording to be looked at: ours is mended if it was cut off, others are read as they are."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording.foreign import Foreign
from crtk_drivers.recording.mcap_format import MAGIC, RECORD, Fields, Opcode
from crtk_drivers.recording.mcap_reader import BeingWritten, MayNotBeMended, Recording, mend

OURS: Final = "crtk-drivers"

_BEGINNING: Final = 4096


def opened(path: str | Path) -> tuple[Recording | Foreign, str]:
    """Return a recording, and what is to be told of it; that is empty if it is whole.

    Raises:
        RecordingError: it cannot be read, is none, or holds nothing that can be read.
    """
    path = Path(path)
    if not is_ours(path):
        foreign = Foreign(path)
        return foreign, foreign.damage and f"{foreign.damage}; what is before that is shown"
    try:
        was_mended = mend(path)
    except BeingWritten:
        return Recording(path), "it is being written: what it has by now is shown"
    except MayNotBeMended:
        found = Recording(path)
        return found, "" if found.is_complete else "it was cut off, and cannot be mended here"
    return Recording(path), "it was cut off, and has been mended" if was_mended else ""


def is_ours(path: Path) -> bool:
    """Whether a file is one of `McapWriter`, by its first record.

    Raises:
        RecordingError: it cannot be read, or is no MCAP file.
    """
    try:
        with path.open("rb") as file:
            begin = file.read(_BEGINNING)
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror or error}", where=str(path)
        ) from error
    if not begin:
        raise RecordingError("is empty", where=str(path))
    if not begin.startswith(MAGIC):
        raise RecordingError(
            "is no MCAP file", where=str(path), remedy="Give a recording of ours, or of ros2 bag."
        )
    try:
        opcode, size = RECORD.unpack_from(begin, len(MAGIC))
        fields = Fields(begin[len(MAGIC) + RECORD.size :][:size])
        return opcode == Opcode.HEADER and bool(fields.text()) and fields.text().startswith(OURS)
    except (struct.error, RecordingError):
        return False
