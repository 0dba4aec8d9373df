"""The plugins that `crtk-driver new` writes, installed: their types."""

from pathlib import Path

import pytest

from crtk_drivers.cli import main
from crtk_drivers.cli.new_command import Kind, variants
from rigs.plugin_install import LONG, install, run

CACHE = Path(__file__).parents[2] / ".mypy_cache" / "plugins"
"""What mypy knows of numpy and of this package, for all of them and the next run: most of its time."""

WORDS = [
    (
        kind,
        *(["--link", link] if kind is Kind.SENSOR else []),
        *(["--streams"] * (streams and kind is Kind.SENSOR)),
    )
    for kind, link, streams in variants()
]


@pytest.mark.sweep(3)
@pytest.mark.timeout(LONG + 20)
@pytest.mark.parametrize("words", WORDS, ids="-".join)
def test_a_new_plugin_has_no_type_errors(words: tuple[str, ...], tmp_path: Path) -> None:
    assert main(["new", words[0], "my_device", *words[1:], "-C", str(tmp_path)]) == 0
    folder = tmp_path / "crtk-driver-my-device"
    environment = install(folder, tmp_path / "installed")
    run(folder, environment, "-m", "mypy", "--cache-dir", str(CACHE))
