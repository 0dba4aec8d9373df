"""Every link between pages leads to a file that exists, and to a heading that is there."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)


def pages() -> list[str]:
    if shutil.which("git") is None:
        found = (path.relative_to(ROOT) for path in ROOT.rglob("*.md"))
        return [str(path) for path in found if not any(part[0] == "." for part in path.parts)]
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"]
    return subprocess.run(
        listed, cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()


def anchors(page: Path) -> set[str]:
    """What GitHub makes of the headings of a page."""
    headings = HEADING.findall(page.read_text("utf-8"))
    return {re.sub(r"[^\w\- ]", "", each.lower()).strip().replace(" ", "-") for each in headings}


@pytest.mark.parametrize("page", pages())
def test_links_lead_somewhere(page: str) -> None:
    here = ROOT / page
    broken = []
    for link in LINK.findall(here.read_text("utf-8")):
        if "://" in link:
            continue
        path, _, anchor = link.partition("#")
        target = (here.parent / path).resolve() if path else here
        is_page = target.suffix == ".md"
        if not target.exists() or (anchor and is_page and anchor not in anchors(target)):
            broken.append(link)
    assert not broken


def test_the_site_leads_to_every_page() -> None:
    """Beside those of docs/ it has pages that are made (docs/site_hooks.py)."""
    found = re.findall(
        r"^ +- .*: ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.MULTILINE
    )
    here = {str(Path(page).relative_to("docs")) for page in pages() if page.startswith("docs/")}
    led_to = {name for name in found if (ROOT / "docs" / name).exists()}
    assert led_to == here
    assert len(found) == len(set(found))
