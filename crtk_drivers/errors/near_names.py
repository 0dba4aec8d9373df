"""Which of some names was probably meant by one that is none of them, as by a slip or a part of it.

A far name is worse than none: it sends its reader the wrong way. So likeness alone does not count
(``nope`` is all in ``canopen``), but how few slips are between two names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import SequenceMatcher
from typing import Final

_SLIPS: Final = ((5, 1), (8, 2))
"""How many slips names of up to so many letters may have; in longer ones there may be `_MOST_SLIPS`."""
_MOST_SLIPS: Final = 3
_SAME_START: Final = 3
"""Letters with which two short names begin: then there may be `_SLIPS_AFTER` (``sinus``, ``sine``)."""
_SLIPS_AFTER: Final = 2
_SAME_BEGINNING: Final = 4
"""Letters with which two names begin: then likeness counts (``movel``, ``move_jp``)."""
_ALIKE: Final = 0.6
_DIGITS: Final = "0123456789"
_SHORTEST_BEGINNING: Final = 2
_SHORTEST_WORD: Final = 3
_LONGEST_OF_A_SERIES: Final = 2
"""Digits of a number that counts: joints, inputs, tests."""
_LONGEST: Final = 100
"""Letters of a name that are looked at: nobody mistypes a longer one, and the search takes its square."""


def near_names(name: str, names: Iterable[str], most: int = 1) -> list[str]:
    """Return the names that are near one, the nearest first, and no more than `most`.

    Near are names with few slips between them (letters that are other ones, too many, left out or swapped);
    names of which one begins the other (``ur5e``, ``ur``); a name that is a word of the other (``netft``,
    ``ati-netft``); and names that begin alike and are alike. The fewest slips come first, then the likest.
    Capitals do not count. Parts that two paths begin with (``bench.lag.``) make them no nearer. Names of a
    series (``joint_6``, ``joint_7``) are not near: who writes a number means it.
    """
    given = name[:_LONGEST].casefold()
    ranks = {each: _rank(given, each[:_LONGEST].casefold()) for each in names}
    near = {each: rank for each, rank in ranks.items() if rank is not None}
    return sorted(sorted(near, reverse=True), key=lambda each: near[each])[:most]


def _rank(name: str, known: str) -> tuple[int, float] | None:
    """Return what sorts the names that are near: slips, and how unlike they are; None for a far one."""
    given, known = _apart(name, known)
    short, long = sorted((given, known), key=len)
    if not short:
        return None if long else (0, 0.0)
    if _are_a_series(given, known):
        return None
    slips = _slips(given, known, _MOST_SLIPS)
    is_near = (
        (len(short) > 1 and slips <= _allowed(short, long))
        or (len(short) >= _SHORTEST_BEGINNING and long.startswith(short))
        or (len(given) >= _SHORTEST_WORD and given in re.split(r"[-_./ ]", known))
    )
    begins_alike = (
        len(short) > _SAME_BEGINNING and short[:_SAME_BEGINNING] == long[:_SAME_BEGINNING]
    )
    if not is_near and not begins_alike:
        return None
    likeness = SequenceMatcher(None, given, known, autojunk=False).ratio()
    return (slips, 1.0 - likeness) if is_near or likeness >= _ALIKE else None


def _allowed(short: str, long: str) -> int:
    """Return how many slips there may be between two names."""
    if short[0] != long[0]:  # who begins a name with another letter means another one
        return 1
    allowed = next((slips for letters, slips in _SLIPS if len(long) <= letters), _MOST_SLIPS)
    return max(allowed, _SLIPS_AFTER) if short[:_SAME_START] == long[:_SAME_START] else allowed


def _are_a_series(one: str, other: str) -> bool:
    """Return whether two names differ only in a number of one or two digits at their ends.

    In a longer number somebody slips: ``xm430-w351`` for ``xm430-w350``.
    """
    stem = one.rstrip(_DIGITS)
    number, its = one[len(stem) :], other[len(other.rstrip(_DIGITS)) :]
    if not number or not its or other != stem + its or number == its:
        return False
    return max(len(number), len(its)) <= _LONGEST_OF_A_SERIES


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
    pairs = enumerate(zip(one, other, strict=False))
    start = next((at for at, (letter, its) in pairs if letter != its), min(len(one), len(other)))
    one, other = one[start:], other[start:]
    before: list[int] = []
    row = list(range(len(other) + 1))
    for i, letter in enumerate(one, start=1):
        before, last, row = row, before, [i]
        for j, its in enumerate(other, start=1):
            row.append(min(before[j] + 1, row[-1] + 1, before[j - 1] + (letter != its)))
            if i > 1 and j > 1 and letter == other[j - 2] and one[i - 2] == its:
                row[j] = min(row[j], last[j - 2] + 1)
    return min(row[-1], most + 1)
