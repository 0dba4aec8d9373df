"""What a clause is, and which there are: `CLAUSES`, by id, in the order of the reports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from crtk_drivers.client.conformance.clause_rows import ROWS, Level, Needs
from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.near_names import near_names


@dataclass(frozen=True, slots=True)
class Clause:
    """One thing that CRTK asks of a device.

    Attributes:
        id: never given to another clause.
        group: the heading that it stands under.
        level: how strongly it is meant.
        needs: what must be permitted to judge it.
        source: where it is said; the abbreviations are in `clause_rows`.
        text: what is asked.
        test: how that is found out.
    """

    id: str
    group: str
    level: Level
    needs: Needs
    source: str
    text: str
    test: str


CLAUSES: Final[Mapping[str, Clause]] = MappingProxyType(
    {
        row[0]: Clause(
            row[0], group, level=row[1], needs=row[2], source=row[3], text=row[4], test=row[5]
        )
        for group, rows in ROWS.items()
        for row in rows
    }
)


def chosen(ids: Iterable[str]) -> tuple[str, ...]:
    """Return the ids that a choice like ``QOS-1`` or ``QOS`` (all of a kind) names; all without any.

    Raises:
        ConfigError: there is no such clause.
    """
    wanted = [each.strip().upper() for each in ids if each.strip()]
    if not wanted:
        return tuple(CLAUSES)
    kinds = {each.partition("-")[0] for each in CLAUSES}
    for each in wanted:
        if each not in CLAUSES and each not in kinds:
            near = near_names(each, [*CLAUSES, *kinds])
            raise ConfigError(
                f"there is no clause {each}",
                where="--only",
                remedy=f"Did you mean {near[0]}?"
                if near
                else "`crtk-driver conform --list` has all.",
            )
    return tuple(each for each in CLAUSES if each in wanted or each.partition("-")[0] in wanted)
