"""Software versions: CB3 (3.x), e-Series (5.x) and PolyScope X (10.x), and what came with which."""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

Version: TypeAlias = tuple[int, int, int, int]
"""Major, minor, bugfix, build."""

Release: TypeAlias = tuple[int, ...]
"""Major and minor, with a bugfix where that counts."""


class Since(NamedTuple):
    """First software of each generation that has something, None where it never got it."""

    cb3: Release | None = (3, 0)
    e_series: Release | None = (5, 0)
    polyscope_x: Release | None = (10, 0)

    def reached_by(self, version: Release) -> bool:
        """Whether the software `version` has it."""
        first = {3: self.cb3, 5: self.e_series}.get(version[0], self.polyscope_x)
        return first is not None and tuple(version) >= first


ALWAYS: Final = Since()
E_SERIES: Final = Since(cb3=None)
"""What every e-Series and PolyScope X controller has, and CB3 never got."""
