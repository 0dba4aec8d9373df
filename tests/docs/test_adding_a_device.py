"""The pages that explain how to add a device, and how to test it, show code that exists."""

import re
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "adding_a_device.md"
WORLD_PAGE = ROOT / "docs" / "testing_in_the_world.md"
BLOCK = re.compile(r"^```(?:python|toml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
EXCERPT = re.compile(
    r"^<!-- (?:not run: )?from (?P<path>\S+) -->\n```(?:python|toml)\n(?P<code>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
EXCERPTS, WORLD_EXCERPTS = (
    [(match["path"], match["code"]) for match in EXCERPT.finditer(page.read_text())]
    for page in (PAGE, WORLD_PAGE)
)


def is_in(code: str, source: str) -> bool:
    return f"\n{code}" in f"\n{source}"


@pytest.mark.parametrize(("path", "code"), EXCERPTS + WORLD_EXCERPTS)
def test_an_excerpt_is_in_its_file(path: str, code: str) -> None:
    assert is_in(code, (ROOT / path).read_text()), textwrap.indent(code, f"{path}: ")


def test_every_block_of_code_is_an_excerpt() -> None:
    assert len(EXCERPTS) == len(BLOCK.findall(PAGE.read_text())) > 8
    assert len(WORLD_EXCERPTS) == 6


def test_an_excerpt_that_was_changed_is_found_out() -> None:
    assert is_in("b = 2\n", "a = 1\nb = 2\n")
    assert not is_in("b = 3\n", "a = 1\nb = 2\n")
    assert not is_in("= 2\n", "a = 1\nb = 2\n")


def test_every_method_of_the_contract_between_core_and_device_is_explained() -> None:
    page = PAGE.read_text()
    for word in ("read", "write", "stop", "enable", "condition", "Capabilities", "DeviceContract"):
        assert word in page
