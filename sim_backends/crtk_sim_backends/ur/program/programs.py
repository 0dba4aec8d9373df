"""The programs and installations of a controller: a folder of files, and two programs of its own.

PolyScope keeps a program as ``name.urp`` (its tree, compressed) and writes what the controller
executes beside it as ``name.script``. Only the latter can be run here. PolyScope X keeps both in one
``.urpx``, in JSON; those are uploaded.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final

PROGRAM_FOLDER: Final = "/programs/"
DEFAULT_INSTALLATION: Final = "default.installation"

_IDLE_PROGRAM: Final = "def {}():\n  while (True):\n    sleep(0.1)\n  end\nend\n"
_BUILT_IN: Final = ("external_control.urp", "simulation.urp")
_FOLDERS: Final = (PROGRAM_FOLDER, "/ursim/programs/")
_GZIP: Final = b"\x1f\x8b"
_DEFINITION: Final = re.compile(r"^\s*(def|sec)\b", re.MULTILINE)


class ProgramError(Exception):
    """A file that is there and cannot be loaded."""


class UploadedProgram:
    """A program of PolyScope X.

    Args:
        content: of its .urpx: the tree of the program, and the script that was made of it.

    Attributes:
        content: the same.
        name: of the program, with .urp.
        text: script that the controller executes: the application's, then the program's.

    Raises:
        ProgramError: it is no such file.
    """

    def __init__(self, content: Mapping[str, Any]) -> None:
        self.content = content
        name = _text_at(content, "program", "programInformation", "name")
        script = _text_at(content, "program", "urscript", "script")
        if not name or script is None:
            raise ProgramError("it has no program with a name and a script")
        self.name = f"{name}.urp"
        before = _text_at(content, "application", "urscript", "script") or ""
        self.text = f"def {_identifier(name)}():\n{before}\n{script}\nend\n"


class ProgramFiles:
    """What `load` and `load installation` find, and what is loaded.

    Args:
        folder: programs and installations; None for the built-in programs alone.

    Attributes:
        loaded: path of the loaded program within the folder, "" when none is.
        installation: the same of the installation.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._uploaded: dict[str, UploadedProgram] = {}
        self._text = ""
        self.loaded = ""
        self.installation = DEFAULT_INSTALLATION

    @property
    def text(self) -> str:
        """Script of the loaded program."""
        return self._text

    def names(self) -> list[str]:
        """Paths of the programs that can be loaded."""
        found = {*_BUILT_IN, *self._uploaded}
        if self._folder is not None:
            for path in self._folder.rglob("*"):
                if path.suffix in (".urp", ".script"):
                    found.add(str(path.relative_to(self._folder).with_suffix(".urp")))
        return sorted(found)

    def uploaded(self, name: str) -> UploadedProgram | None:
        """Program that was uploaded under this name, None for none."""
        return self._uploaded.get(name)

    def upload(self, program: UploadedProgram) -> None:
        """Keep a program, in place of an uploaded one of the same name."""
        self._uploaded[program.name] = program

    def load(self, name: str, text: str) -> None:
        """Remember a program as the loaded one."""
        self.loaded, self._text = _within(name), text

    def read(self, name: str) -> str:
        """Script of a program, given by its path within the folder or by the one on a robot.

        Raises:
            FileNotFoundError: there is none such.
            ProgramError: it is no program that can be run here.
        """
        path = self._path(name)
        if path is None:
            if name in self._uploaded:
                return self._uploaded[name].text
            if _within(name) in _BUILT_IN:
                return _IDLE_PROGRAM.format(_within(name).removesuffix(".urp"))
            raise FileNotFoundError(name)
        script = path.with_suffix(".script")
        path = script if script.is_file() else path
        try:
            data = path.read_bytes()
        except OSError as error:
            raise ProgramError(f"{path.name} cannot be read: {error}") from error
        if data.startswith(_GZIP):
            raise ProgramError(f"{path.name} needs its script {script.name} beside it")
        try:
            text = data.decode()
        except UnicodeDecodeError as error:
            raise ProgramError(f"{path.name} is no script: {error}") from error
        return (
            text if _DEFINITION.search(text) else f"def {_identifier(path.stem)}():\n{text}\nend\n"
        )

    def has_installation(self, name: str) -> bool:
        """Whether there is such an installation."""
        return _within(name) == DEFAULT_INSTALLATION or self._path(name) is not None

    def load_installation(self, name: str) -> None:
        """Remember an installation as the loaded one."""
        self.installation = _within(name)

    def _path(self, name: str) -> Path | None:
        """File of that name; None when there is none, or when it is outside of the folder."""
        if self._folder is None:
            return None
        path = (self._folder / _within(name)).resolve()
        return path if path.is_relative_to(self._folder.resolve()) and path.is_file() else None


def _within(name: str) -> str:
    """Path within the folder of programs."""
    for folder in _FOLDERS:
        name = name.removeprefix(folder)
    return str(PurePosixPath(name.lstrip("/")))


def _text_at(content: Any, *keys: str) -> str | None:
    """Text in nested objects; None where there is none."""
    for key in keys:
        content = content.get(key) if isinstance(content, Mapping) else None
    return content if isinstance(content, str) else None


def _identifier(name: str) -> str:
    return re.sub(r"\W|^(?=\d)", "_", name)
