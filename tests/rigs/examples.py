"""How many examples of a property are tried: most of them are for the night, as slow tests are."""

from __future__ import annotations

from hypothesis import settings

ALL = 100
"""Examples of a property that says nothing else, where slow tests run too."""

QUICK = 25
"""Where they are left out."""

FEWEST = 5


def examples(count: int) -> int:
    """Return how many are tried now of a property for which there are so many at night."""
    return max(FEWEST, count * settings.default.max_examples // ALL)
