"""Every command, option and key that a page names is there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from crtk_drivers import plugins
from rigs.documented_names import Page, wrong_command, wrong_key

ROOT = Path(__file__).parents[2]
FOUND = [
    *ROOT.glob("*.md"),
    *ROOT.glob("docs/*.md"),
    *ROOT.glob("examples/**/README.md"),
    *ROOT.glob("crtk_drivers/cli/templates/**/README.md"),
]
PAGES = {str(path.relative_to(ROOT)): path for path in sorted(FOUND) if path.stem != "CHANGELOG"}


@pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)
def test_commands_and_options_exist(page: Path) -> None:
    wrong = {typed: why for typed in Page(page).commands() if (why := wrong_command(typed))}
    assert not wrong


@pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)
def test_keys_of_devices_exist(page: Path) -> None:
    content = Page(page)
    if not content.devices:
        return
    assert not [why for key in content.named_keys() if (why := wrong_key(content.devices, key))]


@pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)
def test_keys_of_lab_files_exist(page: Path) -> None:
    wrong = [why for lab in Page(page).lab_files() for why in _wrong_in_lab(lab)]
    assert not wrong


def _wrong_in_lab(lab: Mapping[str, Any]) -> Iterator[str]:
    for name, value in _leaves(lab):
        if name[:1] == ("devices",) and name[2:3] in (("settings",), ("sim_options",)):
            plugin = lab["devices"][name[1]].get("plugin", "")
            is_key = name[2] == "settings" and plugin in plugins.devices()
            why = wrong_key([plugin], name[3:]) if is_key else ""
        else:
            why = wrong_key(["lab"], name)
        if why:
            yield f"{why} ({value!r})"


def _leaves(
    content: Mapping[str, Any], above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, (*above, name))
        else:
            yield (*above, name), value
