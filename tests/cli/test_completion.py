"""What a shell is told when TAB is pressed after ``crtk-driver``."""

import sys

import pytest

from crtk_drivers.cli import main
from crtk_drivers.cli.own_commands import OWN_COMMANDS


def completions(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: str
) -> list[str]:
    """The words that bash may go on with, after the last of `words`."""
    monkeypatch.setenv("COMP_WORDS", " ".join(("crtk-driver", *words)))
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    monkeypatch.setenv("_CRTK_DRIVER_COMPLETE", "complete_bash")
    main([])
    shown = capsys.readouterr()
    assert not shown.err
    return shown.out.split()


@pytest.fixture
def tab(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    return lambda *words: completions(monkeypatch, capsys, *words)


def test_devices_and_commands_are_completed_without_drivers(
    tab, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [each for each in sys.modules if each.startswith("crtk_driver_")]:
        monkeypatch.delitem(sys.modules, name)
    shown = tab("")
    assert {"ur", "ndi", "loopback", *OWN_COMMANDS} <= set(shown)
    assert tab("robo") == ["robotiq", "robotiq-epick", "robotiq-ft300"]
    assert not [each for each in sys.modules if each.startswith("crtk_driver_")]


def test_options_and_their_values_are_completed(tab) -> None:
    assert tab("loopback", "--ra") == ["--rate"]
    assert tab("loopback", "--log-level", "w") == ["warning"]
    assert tab("ur", "--model", "ur5") == ["ur5", "ur5e"]
    assert tab("-") == [each for each in tab("-") if each.startswith("-")] != []


def test_names_of_plugins_are_completed_where_one_is_asked_for(tab) -> None:
    assert tab("list", "loop") == ["loopback"]
    assert tab("schema", "la") == ["lab"]
    assert "ur" in tab("sim", "u")
    assert "loopback" in tab("check", "loop")


def test_a_word_that_is_no_command_completes_to_nothing(tab) -> None:
    assert tab("no-such-device", "u") == []
    assert tab("no-such-device", "--") == []


@pytest.mark.parametrize("started_by", ["", "./crtk-driver"])
def test_the_script_for_a_shell_names_the_installed_program(
    started_by: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CRTK_DRIVER_SCRIPT", started_by)
    assert main(["--show-completion", "bash"]) == 0
    script = capsys.readouterr().out
    assert "complete -o default -F _crtk_driver_completion crtk-driver" in script
    assert "_CRTK_DRIVER_COMPLETE=complete_bash $1" in script
