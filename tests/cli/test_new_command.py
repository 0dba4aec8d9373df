"""`crtk-driver new`: what it writes, what it refuses, and what it says."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from crtk_drivers.cli import main
from crtk_drivers.cli.new_command import TEMPLATES, VARIANTS, Kind, Variant, contents, variants

ROOT = Path(__file__).parents[2]


def new(*arguments: object) -> int:
    return main(["new", *map(str, arguments)])


def words_of(variant: Variant) -> list[str]:
    """Return what is given to the command beside the kind and the name."""
    if variant.kind is not Kind.SENSOR:
        return []
    return ["--link", variant.link, *(["--streams"] if variant.streams else [])]


ALL = pytest.mark.parametrize(
    "variant", [pytest.param(v, id="-".join(map(str, v))) for v in variants()]
)


@ALL
def test_a_plugin_is_written_with_its_name_throughout(
    variant: Variant, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(variant.kind, "torque_watch2", "-C", tmp_path, *words_of(variant)) == 0
    folder = tmp_path / "crtk-driver-torque-watch2"
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    assert project["name"] == "crtk-driver-torque-watch2"
    assert project["entry-points"]["crtk_drivers.devices"] == {
        "torque_watch2": "crtk_driver_torque_watch2:PLUGIN"
    }
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert folder / "src" / "crtk_sim_torque_watch2" / "py.typed" in files
    for path in files:
        text = str(path.relative_to(tmp_path)) + path.read_text()
        assert not [left for left in ("my_", "my-", "MyS", "MyA", "MyG", "<!--") if left in text], (
            path
        )
    said = capsys.readouterr().out
    for step in (f"'{folder}[test]'", "crtk-driver list torque_watch2", f"pytest {folder}"):
        assert step in said


def test_every_template_is_a_kind_and_has_what_a_plugin_needs() -> None:
    folders = {path.name for path in TEMPLATES.iterdir() if path.is_dir()}
    assert folders == {*Kind, VARIANTS.name}
    assert {path.name for path in VARIANTS.iterdir()} == {Kind.SENSOR}
    for variant in variants():
        names = {Path(path).name for path, _ in contents(variant, "x")}
        assert {"pyproject.toml", "README.md", "test_contract.py", "protocol.py"} <= names


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "crtk-driver-my-scale"
    folder.mkdir()
    assert new("sensor", "my_scale", "-C", tmp_path) == 2
    assert not list(folder.iterdir())
    error = capsys.readouterr().err
    assert "is there already" in error
    assert "--directory" in error


@pytest.mark.parametrize(
    ("words", "wrong", "example"),
    [
        ((), "a kind and a name are missing", "new sensor my_scale"),
        (("sensor",), "a name is missing", "new sensor my_scale"),
        (("arm",), "a name is missing", "new arm my_robot"),
        (("foo", "bar"), "there is no template 'foo'", "new sensor my_scale"),
        (("foo",), "a name is missing", "new sensor my_scale"),
        (("-C", ".", "foo", "bar"), "there is no template 'foo'", "new sensor my_scale"),
        (("griper", "bar"), "'griper'. Did you mean gripper? ", "new gripper my_hand"),
        (("sensor", "my", "scale"), "too many words: scale", "new sensor my_scale"),
    ],
)
def test_wrong_words_are_answered_with_what_can_be_given(
    words: tuple[str, ...], wrong: str, example: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(*words) == 2
    error = " ".join(capsys.readouterr().err.replace("hint:", "").split())
    for text in (wrong.replace("'. D", "' D"), "Give one of sensor, arm, gripper", example):
        assert text in error, error


@pytest.mark.parametrize(
    ("name", "reason", "way_out"),
    [
        ("My-Scale", "no name for Python modules", "Call it my_scale."),
        ("9a", "no name for Python modules", "Choose another."),
        ("a__b", "no name for Python modules", "Call it a_b."),
        ("../a", "no name for Python modules", "Call it a."),
        ("a" * 41, "more than 40 characters", "a" * 40),
        ("class", "a word of Python", "Choose another."),
        ("ur", "crtk-drivers has a device of that name", "crtk-driver list"),
        ("ati_netft", "crtk-drivers has a device of that name", "crtk-driver list"),
        ("can", "crtk-drivers has a simulator of that name", "crtk-driver list"),
        ("sim", "`crtk-driver sim` is a command", "Choose another"),
        ("new", "`crtk-driver new` is a command", "Choose another"),
    ],
)
def test_a_name_that_cannot_be_is_refused_with_a_reason(
    name: str, reason: str, way_out: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new("sensor", name, "-C", tmp_path) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert reason in error
    assert way_out in error
    assert not list(tmp_path.iterdir())


def test_a_module_of_that_name_is_not_shadowed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "crtk_sim_scale9.py").write_text("")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert new("sensor", "scale9", "-C", tmp_path) == 2
    assert "there is a module crtk_sim_scale9" in capsys.readouterr().err


def test_the_help_says_what_it_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert new("--help") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Write a plugin for a device of your own" in said
    assert "crtk-driver new sensor my_scale" in said
    for kind in Kind:
        assert kind in said


@pytest.mark.parametrize(
    ("kind", "option", "said"),
    [
        ("arm", ["--link", "serial"], "--link serial"),
        ("gripper", ["--link", "tcp"], "--link tcp"),
        ("gripper", ["--streams"], "--streams"),
        ("sensor", ["--link", "usb"], "'usb' is not one of"),
    ],
)
def test_a_variant_that_there_is_not_is_refused(
    kind: str, option: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(kind, "my_device", "-C", tmp_path, *option) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


@ALL
def test_what_is_written_is_formatted_and_has_no_findings(variant: Variant, tmp_path: Path) -> None:
    assert new(variant.kind, "my_device", "-C", tmp_path, *words_of(variant)) == 0
    for command in (["check"], ["format", "--check"]):
        arguments = [sys.executable, "-m", "ruff", *command, "--no-cache", str(tmp_path)]
        done = subprocess.run(arguments, capture_output=True, text=True, timeout=50)
        assert done.returncode == 0, done.stdout + done.stderr
