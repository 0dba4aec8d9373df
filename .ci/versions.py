"""Check that every version is stated as in its one source: python3 .ci/versions.py [TAG]

The source of a version is `version` in the pyproject.toml of its package. TAG must be `v` and the version of
crtk-drivers, and the changelog must have released that version.
"""

import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

MESSAGES = ("crtk_msgs", "tf2_msgs", "control_msgs", "controller_manager_msgs")
"""Folders of the packages that are compiled; each has a version of its own."""
UNRELEASED = re.compile(r"^## Unreleased\b", re.MULTILINE)


@dataclass(frozen=True)
class Statement:
    """A place that states a version again.

    Attributes:
        file: its path from the root.
        pattern: what finds the version there, as its only group.
    """

    file: str
    pattern: str


STATEMENTS = {
    ".": (
        Statement("CITATION.cff", r'^version: "?([^"\s]+)"?$'),
        Statement("CHANGELOG.md", r"\A(?:(?!^## ).*\n)*## (?:Unreleased \()?([\d.]+\w*)"),
    ),
    **{
        folder: (
            Statement(f"{folder}/package.xml", r"^  <version>(.*)</version>$"),
            Statement(f"{folder}/CMakeLists.txt", rf"^project\({folder} VERSION (.*)\)$"),
        )
        for folder in MESSAGES
    },
}
"""What is stated beside the pyproject.toml of a folder."""


def version(root: Path, folder: str = ".") -> str:
    """Return the version of the package in a folder."""
    project = tomllib.loads((root / folder / "pyproject.toml").read_text("utf-8"))["project"]
    return str(project["version"])


def differences(root: Path) -> Iterator[str]:
    """Yield a line for each place that does not state the version of its package."""
    for folder, statements in STATEMENTS.items():
        own = version(root, folder)
        for each in statements:
            text = (root / each.file).read_text("utf-8")
            found = re.search(each.pattern, text, re.MULTILINE)
            stated = found[1] if found else "no version"
            if stated != own:
                source = Path(folder, "pyproject.toml")
                yield f"{each.file} states {stated}, and {source} {own}: write {own} there"


def tag_differences(root: Path, tag: str) -> Iterator[str]:
    """Yield a line for each reason not to release under a tag."""
    own = version(root)
    if tag != f"v{own}":
        yield f"the tag is {tag}, and pyproject.toml states {own}: its tag is v{own}"
    if UNRELEASED.search((root / "CHANGELOG.md").read_text("utf-8")):
        yield f"CHANGELOG.md has an unreleased section: head it {own} and the day"


def main(arguments: Sequence[str]) -> None:
    """Print the version of crtk-drivers, or end with what differs from it."""
    root = Path(__file__).parents[1]
    found = [
        *differences(root),
        *(line for tag in arguments for line in tag_differences(root, tag)),
    ]
    if found:
        sys.exit("\n".join(found))
    print(version(root))


if __name__ == "__main__":
    main(sys.argv[1:])
