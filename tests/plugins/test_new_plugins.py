"""The plugins that `crtk-driver new` writes, installed: types, and their own tests with the contract."""

import subprocess
import sys
from pathlib import Path

import pytest

from crtk_drivers.cli import main
from crtk_drivers.cli.new_command import Kind
from rigs.plugin_install import install

LONG = 280
LIST = "import sys; from crtk_drivers.cli import main; sys.exit(main(['list', 'my_device']))"


def run(folder: Path, environment: dict[str, str], *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=LONG,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.timeout(LONG + 20)
@pytest.mark.parametrize("kind", Kind)
def test_a_new_plugin_passes_its_tests(kind: Kind, tmp_path: Path) -> None:
    assert main(["new", kind, "my_device", "-C", str(tmp_path)]) == 0
    folder = tmp_path / "crtk-driver-my-device"
    environment = install(folder, tmp_path / "installed")
    listed = run(folder, environment, "-c", LIST)
    assert "measured" in listed
    assert "broken" not in listed
    said = run(
        folder,
        environment,
        "-m",
        "pytest",
        "-q",
        "-n",
        "0",
        "-p",
        "no:cacheprovider",
        "--timeout=120",
    )
    assert "passed" in said


@pytest.mark.slow
@pytest.mark.timeout(LONG + 20)
@pytest.mark.parametrize("kind", Kind)
def test_a_new_plugin_has_no_type_errors(kind: Kind, tmp_path: Path) -> None:
    assert main(["new", kind, "my_device", "-C", str(tmp_path)]) == 0
    folder = tmp_path / "crtk-driver-my-device"
    environment = install(folder, tmp_path / "installed")
    run(folder, environment, "-m", "mypy", "--cache-dir", str(tmp_path / "cache"))
