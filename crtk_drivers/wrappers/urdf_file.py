"""URDF files, read with care."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from crtk_drivers.config.capped_file import read_capped
from crtk_drivers.kinematics.chain import Chain
from crtk_drivers.kinematics.urdf import MAX_SIZE, parse_urdf

__all__ = ["read_document", "read_urdf"]


def read_urdf(path: Path | str, *, base: str, tip: str, joints: Sequence[str] = ()) -> Chain:
    """Return the chain between two links of a URDF file; see `parse_urdf`.

    Raises:
        ConfigError: missing, not a regular file, too large, or as `parse_urdf`; names the file.
    """
    return parse_urdf(read_document(path), base=base, tip=tip, joints=joints, where=str(path))


def read_document(path: Path | str) -> bytes:
    """Return the bytes of a URDF file.

    Raises:
        ConfigError: missing, not a regular file, or too large; names the file.
    """
    return read_capped(Path(path), MAX_SIZE, "a URDF file")
