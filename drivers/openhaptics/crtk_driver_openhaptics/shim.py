"""Builds and loads what stands between the library's scheduler and Python (``shim.c``)."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from ctypes import POINTER, c_char_p, c_double, c_int, c_uint, c_ulong
from pathlib import Path
from typing import Any, ClassVar, Final

from crtk_drivers.kit.haptics.servo import HandError

__all__ = ["Mailbox", "Shim"]

SOURCE: Final = Path(__file__).with_name("shim.c")
LIBRARIES: Final = ("libHD.so.3.4", "libHD.so.3", "libHD.so")
INSTALL: Final = (
    "Install OpenHaptics and the Touch drivers (3dsystems.com), or set `library` to its libHD.so."
)
COMPILER: Final = "Install one (`sudo apt install gcc`), or name it in CC."
LONGEST_BUILD: Final = 30.0


class Mailbox(ctypes.Structure):
    """As in ``shim.c``: what the callback read last, in the vendor's axes and units."""

    _fields_: ClassVar = [
        ("time", c_double),
        ("transform", c_double * 16),
        ("velocity", c_double * 3),
        ("turning", c_double * 3),
        ("force", c_double * 3),
        ("buttons", c_int),
        ("calibration", c_int),
        ("style", c_int),
        ("forces_on", c_int),
        ("error", c_uint),
        ("frames", c_ulong),
    ]


class Shim:
    """The built library, with the vendor's behind it; only in a process of its own.

    Args:
        path: of the vendor's library; looked for if empty.

    Raises:
        HandError: it cannot be built, or the vendor's is not there.
    """

    def __init__(self, path: str) -> None:
        with tempfile.TemporaryDirectory(prefix="crtk-shim-") as folder:
            self._library = ctypes.CDLL(_build(Path(folder) / "shim.so"))
        for name in ("error", "model", "serial", "words"):
            getattr(self._library, f"shim_{name}").restype = c_char_p
        self._library.shim_read.argtypes = (POINTER(Mailbox),)
        self._library.shim_push.argtypes = (c_double,) * 3
        self._library.shim_open.argtypes = (c_char_p, c_double)
        failures = []
        for place in (path,) if path else LIBRARIES:
            result = self._library.shim_load(place.encode())
            if result == 0:
                return
            failures.append(self.text("error"))
            if result < -1:
                break
        raise HandError(f"its library cannot be used: {'; '.join(failures)}", INSTALL)

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function of the shim."""
        return int(getattr(self._library, f"shim_{name}")(*arguments))

    def text(self, name: str, *arguments: Any) -> str:
        """Call a function that returns words."""
        told: bytes | None = getattr(self._library, f"shim_{name}")(*arguments)
        return (told or b"").decode(errors="replace")

    def read(self, box: Mailbox) -> None:
        """Take what the callback read last."""
        self._library.shim_read(ctypes.byref(box))


def _build(target: Path) -> str:
    compiler = next(
        filter(None, map(shutil.which, (os.environ.get("CC", "cc"), "gcc", "clang"))), None
    )
    if compiler is None:
        raise HandError("there is no C compiler, which builds its callback", COMPILER)
    command = [
        compiler,
        "-O2",
        "-shared",
        "-fPIC",
        "-o",
        str(target),
        str(SOURCE),
        "-lpthread",
        "-ldl",
    ]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=LONGEST_BUILD, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise HandError(f"its callback could not be built: {error}", COMPILER) from error
    if done.returncode:
        raise HandError(f"its callback could not be built: {done.stderr[-1000:]}", COMPILER)
    return str(target)
