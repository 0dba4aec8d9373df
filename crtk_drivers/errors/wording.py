"""Word commands as this process was started: by a clone's script, by ``uv run``, or by an installed program.

Every text writes commands as ``crtk-driver ...`` and ``pip install ...``. `worded` replaces them by those
that work for the reader. It is called where a text reaches a terminal, or a page in the browser, which is
served on this machine only. What is for files, programs and other machines keeps the text: topics, logs in
JSON, recordings, the output of ``crtk-driver schema``.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final

SCRIPT: Final = "CRTK_DRIVER_SCRIPT"
"""The variable in which the script ``crtk-driver`` of a clone says how it was called."""
_BY_UV: Final = "UV_RUN_RECURSION_DEPTH"
"""The variable that ``uv run`` sets."""

_MESSAGES: Final[Mapping[str, tuple[str, ...]]] = {
    "ros": ("crtk_msgs", "tf2_msgs"),
    "all": ("crtk_msgs", "tf2_msgs"),
    "moveit": ("crtk_msgs", "tf2_msgs", "control_msgs"),
    "ros2-control": ("crtk_msgs", "tf2_msgs", "control_msgs", "controller_manager_msgs"),
}
"""Folders of a clone that pip needs beside it for an extra: no index has these packages. Their modules
have the same names."""
RELEASE: Final = "FOLDER_OF_THE_RELEASE"
"""Stands for the folder with the archives of a release (docs/installing.md), where it is not known."""

_COMMAND: Final = re.compile(
    r"(uv run (?:-\S+ (?:[\w.]+ )?)*)?(?<![\w./-])crtk-driver(?= [A-Za-z[-])"
)
_EXTRA: Final = re.compile(r"(?<![\w./-])(?<!-m )pip install 'crtk-drivers\[([\w-]+)\]'")
_INSTALL: Final = re.compile(r"(?<![\w./-])(?<!uv )(?<!-m )pip install(?= [-'./A-Za-z])")


@dataclass(frozen=True)
class Wording:
    """The commands that work for the reader.

    Attributes:
        program: this program, ``crtk-driver``.
        run: what stands before the name of another program of the same environment.
        install: ``pip install`` into that environment.
        extra: the command that brings ``{extra}`` of crtk-drivers.
    """

    program: str
    run: str
    install: str
    extra: str


def by_script() -> bool:
    """Return whether the script of a clone started this process."""
    return bool(os.environ.get(SCRIPT))


def program() -> str:
    """Return how this program was started. Every start asks, so no metadata are read."""
    script = os.environ.get(SCRIPT)
    if script:
        return shlex.quote(script)
    return "uv run crtk-driver" if _BY_UV in os.environ else f"{_folder('crtk-driver')}crtk-driver"


def current_wording() -> Wording:
    """Return the commands that work as this process was started."""
    if by_script():
        return Wording(program(), f"{program()} --run ", *_by_script(program()))
    clone = _clone()
    in_clone = clone is not None and Path(sys.prefix) == clone / ".venv"
    if _BY_UV in os.environ:
        extra = (
            "uv run --extra {extra} crtk-driver --version"
            if in_clone
            else _by_pip("uv pip install")
        )
        return Wording(program(), "uv run ", "uv pip install", extra)
    run = _folder("python3")
    if clone and in_clone and (clone / "crtk-driver").is_file():
        return Wording(program(), run, *_by_script(_short(clone / "crtk-driver")))
    install = f"{_folder('pip')}pip install"
    if not _has("pip"):
        install = f"uv pip install --python {_short(Path(sys.prefix))}"
    return Wording(program(), run, install, _by_pip(install))


def worded(text: str) -> str:
    """Return `text` with each command replaced by the one that works as this process was started."""
    if "crtk-driver" not in text and "pip install" not in text:
        return text
    how = current_wording()
    text = _EXTRA.sub(lambda found: _bringing(how.extra, found[1]), text)
    text = _INSTALL.sub(lambda _: how.install, text)
    return _COMMAND.sub(lambda found: found[0] if found[1] else how.program, text)


def _by_pip(install: str) -> str:
    """Return how pip brings an extra."""
    return f"{install} {{messages}}'crtk-drivers[{{extra}}]'"


def _by_script(script: str) -> tuple[str, str]:
    """Return how a clone's script installs, and how it brings an extra."""
    return f"{script} --pip install", f"{script} --extra {{extra}} --version"


def _bringing(command: str, extra: str) -> str:
    """Return the command that brings an extra, with where pip finds the message packages that it needs."""
    messages = _messages(_MESSAGES.get(extra, ()), install=command.partition("{messages}")[0])
    return command.replace("{extra}", extra).replace("{messages}", messages)


def _messages(names: Sequence[str], install: str) -> str:
    """Return the words by which pip finds message packages: in a clone, or in a release."""
    clone = _clone()
    if clone:
        return "".join(f"{shlex.quote(str(clone / name))} " for name in names)
    if all(map(find_spec, names)):  # by all wheels of a release at once
        return ""
    wheel = _origin("archive_info")
    folder = _short(wheel.parent) if wheel and wheel.is_file() else RELEASE
    # Of the release alone: an index may have a stranger's package of such a name.
    packages = " ".join(f"crtk-{name.removeprefix('crtk_').replace('_', '-')}" for name in names)
    return f"--no-index --no-deps --find-links {folder} {packages} && {install}"


def _clone() -> Path | None:
    """Return the folder that crtk-drivers was installed from; None if it came as a file."""
    return _origin("dir_info")


@cache
def _origin(kind: str) -> Path | None:
    """Return what crtk-drivers was installed from, if PEP 610 has it as ``dir_info`` or ``archive_info``."""
    import json  # these take their time, and are needed for a hint only
    from importlib import metadata
    from urllib.parse import unquote, urlsplit

    try:
        origin = metadata.distribution("crtk-drivers").read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        return None
    found = json.loads(origin) if origin else {}
    if kind not in found or urlsplit(found["url"]).scheme != "file":
        return None
    return Path(unquote(urlsplit(found["url"]).path))


def _has(name: str) -> bool:
    """Return whether this environment has a program."""
    return bool(sys.executable) and (Path(sys.executable).parent / name).exists()


def _folder(name: str) -> str:
    """Return what stands before a program of this environment: nothing if PATH has it, else its folder."""
    if not _has(name):
        return ""
    own = Path(sys.executable).parent
    known = Path(shutil.which(name) or "/")
    # pipx links its scripts into a folder of PATH. The python3 of an environment is itself a link.
    if known.parent == own or known.resolve() == own.resolve() / name:
        return ""
    return f"{_short(own)}/"


def _short(path: Path) -> str:
    """Return a path for a shell: from the working directory if it is below that, else the whole one."""
    try:
        here = Path.cwd()
    except FileNotFoundError:  # it was removed
        here = path
    shown = str(path.relative_to(here) if path != here and path.is_relative_to(here) else path)
    return shlex.quote(shown if "/" in shown else f"./{shown}")


def printable(text: str, keeping: str = "\n\t") -> str:
    """Return what somebody else says without control characters, with which it could write anything.

    Args:
        text: of another program.
        keeping: control characters that stay.
    """
    return "".join(each for each in text if each.isprintable() or each in keeping)
