"""What is written of plugins beside their entry points: it is true of ours, and a stranger's harms nobody."""

import json
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from crtk_drivers import plugins
from crtk_drivers.cli.description_files import files_of, main
from crtk_drivers.errors import PluginError
from crtk_drivers.plugins import PluginEntry
from crtk_drivers.plugins.description import FILE

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
OURS = [
    PluginEntry(EntryPoint(name, target, group))
    for group in (plugins.DEVICES, plugins.SIMS, plugins.PAGES)
    for name, target in PROJECT["entry-points"][group].items()
]

ARM = """
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
PLUGIN = DevicePlugin("acme", "an arm", LoopbackConfig, LoopbackDevice)
"""


@pytest.mark.parametrize("entry", OURS, ids=lambda entry: f"{entry.entry_point.group} {entry.name}")
def test_ours_are_described_as_they_are(entry: PluginEntry) -> None:
    for path, text in files_of([entry]).items():
        assert path.read_text() == text, "run: python -m crtk_drivers.cli.description_files"


def test_no_plugin_is_described_that_is_gone() -> None:
    described = {
        (group, name)
        for path in files_of(OURS)
        for group, entries in json.loads(path.read_text()).items()
        for name in entries
    }
    assert described == {(entry.entry_point.group, entry.name) for entry in OURS}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The package `acme_arm` of a stranger, installed; it is not imported."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv(plugins.ONLY, raising=False)
    info = tmp_path / "acme_arm-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-arm\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text("[crtk_drivers.devices]\nacme = acme_arm:PLUGIN\n")
    folder = tmp_path / "acme_arm"
    folder.mkdir()
    (folder / "__init__.py").write_text(ARM)
    yield folder
    sys.modules.pop("acme_arm", None)


def test_what_is_written_is_told_and_imports_nothing(package: Path) -> None:
    assert main(["--check", "acme"]) == 1
    assert not (package / FILE).exists()
    assert main(["acme"]) == 0
    assert main(["--check", "acme"]) == 0
    del sys.modules["acme_arm"]

    entry = plugins.devices()["acme"]
    assert entry.is_described
    assert entry.description is not None
    assert entry.description.summary == "an arm"
    assert "servo_jp" in entry.description.commands.split()
    assert entry.missing is None
    assert "acme_arm" not in sys.modules
    assert not entry.is_loaded
    assert entry.plugin.summary == "an arm"


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        '{"crtk_drivers.devices": []}',
        '{"crtk_drivers.devices": {"acme": 5}}',
        '{"crtk_drivers.devices": {"acme": {}}}',
        '{"crtk_drivers.devices": {"acme": {"summary": 5}}}',
        '{"crtk_drivers.devices": {"acme": {"summary": "x", "of a later version": "y"}}}',
        '{"crtk_drivers.devices": {"other": {"summary": "x"}}}',
    ],
)
def test_what_cannot_be_read_is_as_if_nothing_were_written(package: Path, text: str) -> None:
    (package / FILE).write_text(text)
    entry = plugins.devices()["acme"]
    assert not entry.is_described
    assert entry.description is not None
    assert entry.description.summary == "an arm"


def test_an_extra_that_is_missing_is_known_without_an_import(package: Path) -> None:
    told = {"acme": {"summary": "an arm", "extra": "arm"}}
    (package / FILE).write_text(json.dumps({plugins.DEVICES: told}))
    metadata = package.parent / "acme_arm-1.2.dist-info" / "METADATA"
    with metadata.open("a") as file:
        file.write("Provides-Extra: arm\nRequires-Dist: no-such-library ; extra == 'arm'\n")
    missing = plugins.devices()["acme"].missing
    assert missing is not None
    assert missing.remedy == "Install it with: pip install 'acme-arm[arm]'"
    assert "acme_arm" not in sys.modules


def test_a_module_without_a_package_cannot_be_described(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "acme_module.py").write_text(ARM)
    entry = PluginEntry(EntryPoint("acme", "acme_module:PLUGIN", plugins.DEVICES))
    assert not entry.is_described
    with pytest.raises(PluginError, match="is in no package"):
        files_of([entry])
