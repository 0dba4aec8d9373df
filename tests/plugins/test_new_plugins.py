"""The plugins that `crtk-driver new` writes, installed: their own tests with the contract."""

from pathlib import Path

import pytest

from crtk_drivers.cli import main
from crtk_drivers.cli.new_command import Kind, variants
from rigs.plugin_install import LONG, install, run

LIST = "import sys; from crtk_drivers.cli import main; sys.exit(main(['list', 'my_device']))"

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
def test_a_new_plugin_passes_its_tests(words: tuple[str, ...], tmp_path: Path) -> None:
    assert main(["new", words[0], "my_device", *words[1:], "-C", str(tmp_path)]) == 0
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
