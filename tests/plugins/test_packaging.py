"""What the distribution declares: entry points that load, types, extras that cover each other."""

import importlib
import pkgutil
import platform
import re
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from crtk_driver_ur import plugin
from crtk_driver_ur.config import UrConfig
from crtk_drivers.errors import MissingExtra

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]
PACKAGES = ("crtk_drivers", "crtk_driver_ur", "crtk_driver_virtual", "crtk_sim_backends")


@pytest.mark.parametrize(
    ("group", "name", "target"),
    [
        ("crtk_drivers.devices", "ur", "crtk_driver_ur:PLUGIN"),
        ("crtk_drivers.devices", "virtual", "crtk_driver_virtual:PLUGIN"),
        ("crtk_drivers.sims", "ur", "crtk_sim_backends.ur:SIM"),
        ("crtk_drivers.pages", "web", "crtk_sim_backends.page.device:PAGE"),
    ],
)
def test_a_built_in_driver_is_an_entry_point_as_a_strangers_is(
    group: str, name: str, target: str
) -> None:
    assert PROJECT["entry-points"][group][name] == target


@pytest.mark.parametrize(
    "target",
    [
        *PROJECT["scripts"].values(),
        *(target for group in PROJECT["entry-points"].values() for target in group.values()),
    ],
)
def test_every_declared_entry_point_loads(target: str) -> None:
    assert pkgutil.resolve_name(target) is not None


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_says_that_it_is_typed(package: str) -> None:
    origin = importlib.import_module(package).__file__
    assert origin is not None
    assert Path(origin).with_name("py.typed").is_file()


def test_every_driver_has_an_extra_and_all_covers_every_extra() -> None:
    extras = PROJECT["optional-dependencies"]
    assert extras["all"] == ["crtk-drivers[drivers,kinematics,plot,ros,view]"]
    (drivers,) = extras["drivers"]
    named = drivers.removeprefix("crtk-drivers[").removesuffix("]").split(",")
    others = [
        "all",
        "drivers",
        "kinematics",
        "moveit",
        "parquet",
        "plot",
        "ros",
        "ros2-control",
        "view",
    ]
    assert sorted([*named, *others]) == sorted(extras)
    folders = {path.name.replace("_", "-") for path in (ROOT / "drivers").iterdir()}
    need_nothing = {"dvrk", "force-dimension", "galil", "inputs", "openhaptics", "raven"}
    need_others = {"virtual", "ros2-control"}
    assert folders - need_nothing - need_others <= set(named)


@pytest.mark.parametrize(
    ("version", "machine", "wheels"),
    [
        ((3, 11), "x86_64", True),
        ((3, 12), "x86_64", True),
        ((3, 13), "x86_64", False),
        ((3, 14), "x86_64", False),
        ((3, 12), "aarch64", False),
    ],
)
def test_where_ur_rtde_has_no_wheels_it_is_left_out_and_the_driver_says_so(
    version: tuple[int, int], machine: str, wheels: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    python = ".".join(map(str, version))
    (needed,) = map(Requirement, PROJECT["optional-dependencies"]["ur"])
    assert needed.marker is not None
    assert needed.marker.evaluate({"python_version": python, "platform_machine": machine}) is wheels

    monkeypatch.setattr(plugin, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "version_info", (*version, 0))
    monkeypatch.setattr(platform, "machine", lambda: machine)
    config = UrConfig(host="127.0.0.1", control="ur_rtde")
    with pytest.raises(MissingExtra, match="ur-rtde is not installed") as caught:
        plugin.PLUGIN.create(config)
    assert (
        f"no wheel of it for Python {python} on {machine}" in caught.value.message
    ) is not wheels
    assert ("Use control: native" in caught.value.remedy) is not wheels
    assert "pip install 'crtk-drivers[ur]'" in caught.value.remedy


def test_uv_run_alone_brings_what_a_user_needs_and_the_second_command_what_tests() -> None:
    """The README's two commands, each in an environment that it makes."""
    groups, defaults = PYPROJECT["dependency-groups"], PYPROJECT["tool"]["uv"]["default-groups"]
    extras = [needed for group in defaults for needed in groups[group]]
    assert extras == ["crtk-drivers[drivers,view]", "crtk-drivers[ros]"]
    assert "\n./crtk-driver --test\n" in (ROOT / "README.md").read_text()
    (second,) = re.findall(r"--group (\w+) pytest", (ROOT / "crtk-driver").read_text())
    named = {Requirement(each).name for each in groups[second]}
    assert {"pytest", "mypy", "ruff", "import-linter"} <= named
    assert "crtk-drivers[kinematics,moveit,plot,ros2-control]" in groups[second]
