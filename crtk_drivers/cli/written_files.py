"""Files that tools write from what the code says, and that tests compare with it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def out_of_date(texts: Mapping[Path, str], only_check: bool) -> list[Path]:
    """Return the files that do not hold their texts; write them, unless they are only to be checked."""
    stale = [
        path
        for path, text in texts.items()
        if not path.is_file() or path.read_text(encoding="utf-8") != text
    ]
    if not only_check:
        for path in stale:
            path.write_text(texts[path], encoding="utf-8")
    return stale
