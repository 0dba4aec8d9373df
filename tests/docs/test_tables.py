"""The tables of what devices offer say what they declare."""

from pathlib import Path

import pytest

from crtk_drivers import plugins
from crtk_drivers.cli import command_reference, conformance_reference

ROOT = Path(__file__).parents[2]
PAGES = [
    page
    for page in [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
    if "<!-- commands of " in page.read_text()
]


def test_there_are_tables() -> None:
    assert ROOT / "docs" / "ur.md" in PAGES


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_are_up_to_date(page: Path) -> None:
    assert command_reference.main(["--check", str(page)]) == 0


def test_a_table_holds_each_command_of_the_device_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- commands of loopback -->\nby hand\n<!-- end -->\nafter\n")
    assert command_reference.main(["--check", str(page)]) == 1
    assert "command_reference" in capsys.readouterr().err
    assert command_reference.main([str(page)]) == 0
    text = page.read_text()
    assert text.startswith("before\n<!-- commands of loopback -->\n\n| | joint | Cartesian |\n")
    assert text.endswith("\n<!-- end -->\nafter\n")
    for name in plugins.commands_of("loopback"):
        if "/" not in name:
            assert text.count(f"`{name}`") + text.count(f"`{name}()`") == 1, name


def test_the_page_on_conformance_has_the_clauses_as_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = ROOT / "docs/conformance.md"
    assert conformance_reference.main(["--check", str(page)]) == 0
    old = tmp_path / "page.md"
    old.write_text(page.read_text().replace("| NAM-1 | MUST |", "| NAM-1 | MAY |"))
    assert conformance_reference.main(["--check", str(old)]) == 1
    assert "conformance_reference" in capsys.readouterr().err
    assert conformance_reference.main([str(old)]) == 0
    assert old.read_text() == page.read_text()
