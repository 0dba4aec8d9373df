"""Hints name the commands that work as the process was started."""

from __future__ import annotations

import sys
from importlib import metadata
from pathlib import Path

import pytest

from crtk_drivers.errors import ConfigError, MissingExtra, wording
from crtk_drivers.errors.wording import worded

EXTRA = "pip install 'crtk-drivers[kinematics]'"
ROS = "pip install 'crtk-drivers[ros]'"
PLUGIN = "pip install 'acme-arm[arm]'"


@pytest.fixture
def by_script(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(wording.SCRIPT, "./crtk-driver")


@pytest.fixture
def by_uv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UV_RUN_RECURSION_DEPTH", "1")


@pytest.fixture
def in_clone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wording, "_clone", lambda: Path(sys.prefix).parent)
    monkeypatch.setattr(sys, "prefix", str(Path(sys.prefix).parent / ".venv"))


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An environment with pip, which is not on PATH, made from a clone in another folder."""
    folder = tmp_path / "venv" / "bin"
    folder.mkdir(parents=True)
    for name in ("pip", "crtk-driver"):
        (folder / name).write_text("#!/bin/sh\n")
        (folder / name).chmod(0o755)
    (folder / "python3").symlink_to("/bin/sh")
    monkeypatch.setattr(sys, "executable", str(folder / "python3"))
    monkeypatch.setattr(sys, "prefix", str(folder.parent))
    monkeypatch.setattr(wording, "_clone", lambda: Path("/home/lab/my clone"))
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.mark.usefixtures("by_script")
@pytest.mark.parametrize(
    ("text", "as_read"),
    [
        ("See: crtk-driver state /ur5", "See: ./crtk-driver state /ur5"),
        ("`crtk-driver list`", "`./crtk-driver list`"),
        (
            f"Install it with: {EXTRA}",
            "Install it with: ./crtk-driver --extra kinematics --version",
        ),
        (PLUGIN, "./crtk-driver --pip install 'acme-arm[arm]'"),
        ("pip install -U dynamixel-sdk", "./crtk-driver --pip install -U dynamixel-sdk"),
    ],
)
def test_a_clones_script_is_named_as_it_was_called(text: str, as_read: str) -> None:
    assert worded(text) == as_read
    assert worded(as_read) == as_read


@pytest.mark.usefixtures("by_uv", "in_clone")
@pytest.mark.parametrize(
    ("text", "as_read"),
    [
        ("See: crtk-driver state /ur5", "See: uv run crtk-driver state /ur5"),
        (EXTRA, "uv run --extra kinematics crtk-driver --version"),
        (PLUGIN, "uv pip install 'acme-arm[arm]'"),
    ],
)
def test_what_uv_started_names_uv(text: str, as_read: str) -> None:
    assert worded(text) == as_read
    assert worded(as_read) == as_read


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("text", "as_read"),
    [
        ("See: crtk-driver state /ur5", "See: venv/bin/crtk-driver state /ur5"),
        (EXTRA, f"venv/bin/{EXTRA}"),
        (PLUGIN, f"venv/bin/{PLUGIN}"),
        (
            ROS,
            "venv/bin/pip install '/home/lab/my clone/crtk_msgs' '/home/lab/my clone/tf2_msgs' "
            "'crtk-drivers[ros]'",
        ),
    ],
)
def test_an_environment_that_is_not_active_is_named(text: str, as_read: str) -> None:
    assert worded(text) == as_read
    assert worded(as_read) == as_read


@pytest.fixture
def from_wheel(installed: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An environment of a wheel, without message packages; the wheel is still there."""
    wheel = tmp_path / "dist" / "crtk_drivers-0.1.0-py3-none-any.whl"
    wheel.parent.mkdir()
    wheel.touch()
    monkeypatch.setattr(wording, "find_spec", lambda name: None)
    monkeypatch.setattr(wording, "_clone", lambda: None)
    monkeypatch.setattr(wording, "_origin", {"archive_info": wheel}.get)
    return wheel


def test_a_wheels_folder_is_named_for_the_messages(from_wheel: Path) -> None:
    assert worded(ROS) == (
        "venv/bin/pip install --no-index --no-deps --find-links ./dist crtk-msgs crtk-tf2-msgs "
        "&& venv/bin/pip install 'crtk-drivers[ros]'"
    )
    assert worded(EXTRA) == f"venv/bin/{EXTRA}"  # needs no messages


def test_a_release_of_an_unknown_folder_is_said(from_wheel: Path) -> None:
    from_wheel.unlink()
    found = worded(ROS)
    assert " --find-links FOLDER_OF_THE_RELEASE crtk-msgs " in found
    assert worded(found) == found


@pytest.mark.usefixtures("from_wheel")
def test_messages_that_are_there_need_no_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wording, "find_spec", {"crtk_msgs": 1, "tf2_msgs": 1}.get)
    assert worded(ROS) == f"venv/bin/{ROS}"


@pytest.mark.parametrize(
    ("origin", "clone", "wheel"),
    [
        ('{"url": "file:///my%20lab/clone", "dir_info": {}}', "/my lab/clone", None),
        ('{"url": "file:///r/c-0.1.whl", "archive_info": {}}', None, "/r/c-0.1.whl"),
        ('{"url": "https://a.example/r/c-0.1.whl", "archive_info": {}}', None, None),
        (None, None, None),
    ],
)
def test_the_origin_is_read_from_metadata(
    origin: str | None, clone: str | None, wheel: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_text(self: metadata.Distribution, name: str) -> str | None:
        return origin

    wording._origin.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(metadata.PathDistribution, "read_text", read_text)
        found = (wording._clone(), wording._origin("archive_info"))
    wording._origin.cache_clear()
    assert found == (clone and Path(clone), wheel and Path(wheel))


def test_the_python_of_an_environment_is_not_its_base(
    installed: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    base = tmp_path / "base"
    base.mkdir()
    (base / "python3").symlink_to("/bin/sh")
    monkeypatch.setenv("PATH", str(base))
    assert wording.current_wording().run == "venv/bin/"


def test_a_link_on_the_path_is_the_program(
    installed: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    links = tmp_path / "links"
    links.mkdir()
    (links / "crtk-driver").symlink_to(installed / "crtk-driver")
    monkeypatch.setenv("PATH", str(links))
    assert worded("crtk-driver list") == "crtk-driver list"
    assert worded(PLUGIN) == f"venv/bin/{PLUGIN}"


def test_an_active_environment_needs_no_folder(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(installed))
    assert worded("crtk-driver list") == "crtk-driver list"
    assert worded(EXTRA) == EXTRA


def test_a_clones_environment_without_pip_names_its_script(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clone = installed.parents[1]
    (installed.parent).rename(clone / ".venv")
    (clone / "crtk-driver").write_text("#!/bin/sh\n")
    monkeypatch.setattr(sys, "executable", str(clone / ".venv" / "bin" / "python3"))
    monkeypatch.setattr(sys, "prefix", str(clone / ".venv"))
    monkeypatch.setattr(wording, "_clone", lambda: clone)
    assert worded("crtk-driver list") == ".venv/bin/crtk-driver list"
    assert worded(PLUGIN) == "./crtk-driver --pip install 'acme-arm[arm]'"


@pytest.mark.usefixtures("by_script")
def test_prose_paths_and_names_stay() -> None:
    for text in (
        "crtk-driver-my-scale is a folder",
        "/opt/crtk/bin/crtk-driver state",
        "uv run --isolated --extra ur crtk-driver state",
        "python3 -m pip install acme",
        "the log of crtk-driver",
        "it needs pip installed",
    ):
        assert worded(text) == text


@pytest.mark.usefixtures("by_script")
def test_errors_leave_as_they_are_written() -> None:
    error = ConfigError("is missing", remedy="`crtk-driver schema ur` lists them all.")
    assert str(error) == "is missing. `crtk-driver schema ur` lists them all."
    missing = MissingExtra("pin", "kinematics")
    assert missing.remedy == f"Install it with: {EXTRA}"
    assert "./crtk-driver --extra kinematics --version" in str(missing)


def test_a_script_with_a_space_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(wording.SCRIPT, "/my lab/{x}/crtk-driver")
    assert worded("crtk-driver list") == "'/my lab/{x}/crtk-driver' list"
    assert worded(EXTRA) == "'/my lab/{x}/crtk-driver' --extra kinematics --version"


def test_an_environment_of_uv_without_pip_is_named(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (installed / "pip").unlink()
    assert worded(PLUGIN) == "uv pip install --python ./venv 'acme-arm[arm]'"
    monkeypatch.setenv("UV_RUN_RECURSION_DEPTH", "1")
    assert worded(EXTRA) == "uv pip install 'crtk-drivers[kinematics]'"


def test_a_folder_that_was_removed_is_no_error(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = installed / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert worded("crtk-driver list") == f"{installed}/crtk-driver list"
    monkeypatch.setattr(sys, "executable", None)
    assert worded("crtk-driver list") == "crtk-driver list"
