"""Which of some names was probably meant by one that is none of them, as by a slip or a part of it.

A far name is worse than none: it sends its reader the wrong way. So likeness alone does not count
(``nope`` is all in ``canopen``), but how few slips are between two names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import SequenceMatcher
from typing import Final

_SLIPS: Final = ((4, 1), (8, 2))
"""How many slips names of up to so many letters may have; in longer ones there may be `_MOST_SLIPS`."""
_MOST_SLIPS: Final = 3
_SAME_BEGINNING: Final = 4
"""Letters with which two names begin: then likeness counts (``movel``, ``move_jp``)."""
_ALIKE: Final = 0.6
_SHORTEST_BEGINNING: Final = 2
_SHORTEST_WORD: Final = 3


def near_names(name: str, names: Iterable[str], most: int = 1) -> list[str]:
    """Return the names that are near one, the nearest first, and no more than `most`.

    Near are names with few slips between them (letters that are other ones, too many, left out or swapped);
    names of which one begins the other (``ur5e``, ``ur``); a name that is a word of the other (``netft``,
    ``ati-netft``); and names that begin alike and are alike. Capitals do not count. Parts that two paths
    begin with (``bench.lag.``) make them no nearer.
    """
    near = {each: _likeness(name, each) for each in names if _is_near(name, each)}
    return sorted(near, key=lambda each: (near[each], each), reverse=True)[:most]


def _likeness(one: str, other: str) -> float:
    return SequenceMatcher(None, one.casefold(), other.casefold(), autojunk=False).ratio()


def _is_near(name: str, known: str) -> bool:
    given, known = _apart(name.casefold(), known.casefold())
    short, long = sorted((given, known), key=len)
    if not short:
        return not long
    if len(short) >= _SHORTEST_BEGINNING and long.startswith(short):
        return True
    if len(given) >= _SHORTEST_WORD and given in re.split(r"[-_./ ]", known):
        return True
    begins_alike = short[:_SAME_BEGINNING] == long[:_SAME_BEGINNING]
    if begins_alike and len(short) > _SAME_BEGINNING and _likeness(given, known) >= _ALIKE:
        return True
    allowed = next((slips for letters, slips in _SLIPS if len(long) <= letters), _MOST_SLIPS)
    if short[0] != long[0]:  # who begins a name with another letter means another one
        allowed = 1
    return len(short) > 1 and _slips(given, known, allowed) <= allowed


def _apart(one: str, other: str) -> tuple[str, str]:
    """Return two paths without the parts that both begin with."""
    while True:
        head, dot, rest = one.partition(".")
        if not dot or not other.startswith(head + dot):
            return one, other
        one, other = rest, other.removeprefix(head + dot)


def _slips(one: str, other: str, most: int) -> int:
    """Return how many letters are other ones, too many, left out, or swapped; more than `most` if it is."""
    if abs(len(one) - len(other)) > most:
        return most + 1
    before: list[int] = []
    row = list(range(len(other) + 1))
    for i, letter in enumerate(one, start=1):
        before, last, row = row, before, [i]
        for j, its in enumerate(other, start=1):
            row.append(min(before[j] + 1, row[-1] + 1, before[j - 1] + (letter != its)))
            if i > 1 and j > 1 and letter == other[j - 2] and one[i - 2] == its:
                row[j] = min(row[j], last[j - 2] + 1)
    return row[-1]
