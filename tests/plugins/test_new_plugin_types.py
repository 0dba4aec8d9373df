"""The plugins that `crtk-driver new` writes, installed: their types."""

from pathlib import Path

import pytest

from crtk_drivers.cli import main
from crtk_drivers.cli.new_command import Kind
from rigs.plugin_install import LONG, install, run


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What mypy knows of numpy and of this package, for all of them: it takes as long as all else."""
    return tmp_path_factory.mktemp("cache")


@pytest.mark.slow
@pytest.mark.timeout(LONG + 20)
@pytest.mark.parametrize("kind", Kind)
def test_a_new_plugin_has_no_type_errors(kind: Kind, tmp_path: Path, cache: Path) -> None:
    assert main(["new", kind, "my_device", "-C", str(tmp_path)]) == 0
    folder = tmp_path / "crtk-driver-my-device"
    environment = install(folder, tmp_path / "installed")
    run(folder, environment, "-m", "mypy", "--cache-dir", str(cache))
