"""The programs that write files from what the code says: each says which it wrote, and which are stale."""

from pathlib import Path
from types import ModuleType

import pytest

from crtk_drivers import plugins
from crtk_drivers.cli import (
    command_reference,
    config_reference,
    conformance_reference,
    description_files,
    type_stubs,
)

Capture = pytest.CaptureFixture[str]

OF_PAGES = [command_reference, conformance_reference, config_reference]


@pytest.mark.parametrize("program", OF_PAGES, ids=lambda each: each.__name__)
def test_a_page_is_written_once_and_named(
    program: ModuleType, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(plugins.ONLY, "loopback")
    monkeypatch.chdir(tmp_path)
    page = Path("page.md")
    page.write_text("<!-- commands of loopback -->\n<!-- end -->\n<!-- clauses -->\n<!-- end -->\n")
    assert program.main(["--check", "page.md"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("out of date: page.md\nrun: ")
    assert said.err.endswith(f"python -m {program.__name__} page.md\n")
    assert program.main(["page.md"]) == 0
    assert capsys.readouterr().out == "wrote page.md\n"
    assert program.main(["page.md"]) == 0
    assert capsys.readouterr().out == "page.md is up to date\n"
    assert program.main(["--check", "page.md"]) == 0
    assert capsys.readouterr() == ("", "")


def test_each_of_several_files_is_named(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds, devices = tmp_path / "kinds.pyi", tmp_path / "devices.pyi"
    devices.write_text(type_stubs.DEVICES.read_text())
    monkeypatch.setattr(type_stubs, "KINDS", kinds)
    monkeypatch.setattr(type_stubs, "DEVICES", devices)
    assert type_stubs.main([]) == 0
    assert capsys.readouterr().out == f"wrote {kinds}\n{devices} is up to date\n"


def test_descriptions_of_no_plugin_are_refused(capsys: Capture) -> None:
    with pytest.raises(SystemExit) as stopped:
        description_files.main(["loopback", "no_such"])
    assert stopped.value.code == 2
    assert "there is no plugin 'no_such'" in capsys.readouterr().err
