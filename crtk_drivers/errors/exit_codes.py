"""Exit codes of `crtk-driver` that whoever starts it acts on."""

from typing import Final

USAGE_ERROR: Final = 2
"""It cannot be started as asked: it is not started again."""

NOT_INSTALLED: Final = 69
"""A library is missing (EX_UNAVAILABLE of sysexits.h). It may come back: it is tried again."""
