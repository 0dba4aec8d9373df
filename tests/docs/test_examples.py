"""Every Python block of the documentation and every script directly in examples/ runs as it stands.

The blocks of one page are one program, run from top to bottom. A block that needs hardware, or
shows a fragment, is preceded by an HTML comment that begins with `not run:` and says why.

Scripts are forked from a process that has imported what they import; at night they are started as users do.
"""

import os
import re
import select
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile

import pytest

from rigs.warm_start import server

ROOT = Path(__file__).parents[2]
LONG = 200.0
"""Seconds for a page, which takes two where nobody else wants the processor."""

pytestmark = pytest.mark.timeout(LONG + 20.0)

SCRIPTS = sorted(ROOT.glob("examples/*.py"))
BLOCK = re.compile(r"^```python\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL)
NOT_RUN = re.compile(r"<!-- not run:[^>]*-->\n+\Z")


def program(page: str) -> str:
    """The Python blocks of a page, on the lines where the page has them; all else blank."""
    lines = [""] * page.count("\n")
    for block in BLOCK.finditer(page):
        if NOT_RUN.search(page, 0, block.start()):
            continue
        first = page.count("\n", 0, block.start("code"))
        code = block["code"].splitlines()
        lines[first : first + len(code)] = code
    return "\n".join(lines)


PAGES = [
    page
    for page in [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
    if page.is_file() and program(page.read_text()).strip()
]


Run = Callable[[Path, Path], None]


@pytest.fixture(params=["forked", pytest.param("started", marks=pytest.mark.slow)])
def run(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a script in a folder; what it has started ends with it, whatever became of it."""

    def run(script: Path, folder: Path) -> None:
        monkeypatch.chdir(folder)
        with TemporaryFile("w+") as said:
            if request.param == "forked":
                files = said.fileno(), said.fileno(), ()
                process = server().start_program("rigs.script", [str(script)], *files)
            else:
                process = subprocess.Popen(
                    [sys.executable, str(script)],
                    stdin=subprocess.PIPE,
                    stdout=said,
                    stderr=said,
                    start_new_session=True,
                )
            with process:
                process.stdin.close()
                try:
                    code = process.wait(LONG)
                finally:
                    with suppress(ProcessLookupError):  # nothing of it is left
                        os.killpg(process.pid, signal.SIGKILL)
            said.seek(0)
            assert code == 0, f"{script}\n{said.read()}"

    return run


@pytest.mark.sweep(1)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_python_of_a_page_runs(page: Path, tmp_path: Path, run: Run) -> None:
    script = tmp_path / f"page_{page.stem}.py"  # canopen.py would hide the library
    script.write_text(program(page.read_text()))
    run(script, tmp_path)


@pytest.mark.sweep(1)
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: str(script.relative_to(ROOT)))
def test_an_example_runs(script: Path, tmp_path: Path, run: Run) -> None:
    run(script, tmp_path)


def test_a_block_keeps_its_line_and_one_marked_as_not_run_is_left_out() -> None:
    page = "# A\n\n```python\nx = 1\n```\n\n<!-- not run: a fragment -->\n```python\ny\n```\n"
    assert program(page).splitlines()[3] == "x = 1"
    assert program(page).split() == ["x", "=", "1"]


LEAVES_ITS_DEVICE = """
import subprocess, sys
from pathlib import Path

device = subprocess.Popen(["sleep", "600"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
Path("device").write_text(str(device.pid))
sys.exit("it failed")
"""


def test_what_a_failed_script_has_started_ends(tmp_path: Path, run: Run) -> None:
    script = tmp_path / "script.py"
    script.write_text(LEAVES_ITS_DEVICE)
    with pytest.raises(AssertionError, match="it failed"):
        run(script, tmp_path)
    try:
        device = os.pidfd_open(int((tmp_path / "device").read_text()))
    except ProcessLookupError:
        return
    assert select.select([device], [], [], 20.0)[0], "it runs on"
    os.close(device)
