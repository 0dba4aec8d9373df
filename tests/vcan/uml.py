"""Run tests over a real SocketCAN where the kernel has none: ``python tests/vcan/uml.py [pytest arguments]``.

Starts user-mode Linux, a kernel with CAN that is an ordinary process, on the files of this machine; in it
`vcan0` is up and pytest runs, tests/vcan when no files are given. Needs Debian's apt (for the packages
user-mode-linux and can-utils, unpacked in a folder of their own and not installed), iproute2, and root.
Ends with pytest's exit code.
"""

from __future__ import annotations

import ctypes
import json
import os
import platform
import shlex
import signal
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

PACKAGES = ("user-mode-linux", "can-utils")
MODULES = ("can", "can-raw", "can-bcm", "can-dev", "vcan", "slcan")
MOUNTS = (("proc", "/proc"), ("sysfs", "/sys"), ("devpts", "/dev/pts"), ("tmpfs", "/dev/shm"))
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "crtk-uml"
TESTS = Path(__file__).resolve().parent
TIMEOUT = 300.0

# x86_64, as user-mode-linux is: linux/arch/x86/entry/syscalls/syscall_64.tbl, linux/reboot.h
SYS_REBOOT, SYS_FINIT_MODULE = 169, 313
REBOOT = (0xFEE1DEAD, 0x28121969, 0x4321FEDC, 0)
PR_SET_PDEATHSIG = 1  # linux/prctl.h


def unpack(cache: Path) -> Path:
    """Fetch and unpack the packages unless they are there; return where."""
    root = cache / "root"
    if not (root / "usr/bin/linux.uml").exists():
        cache.mkdir(parents=True, exist_ok=True)
        subprocess.run(["apt-get", "download", *PACKAGES], cwd=cache, check=True)
        for package in cache.glob("*.deb"):
            subprocess.run(["dpkg", "-x", package, root], check=True)
    return root


def start(root: Path, arguments: list[str]) -> int:
    """Boot, run pytest with `arguments`, and return its exit code."""
    with tempfile.TemporaryDirectory(prefix="crtk-uml-") as folder:
        job = Path(folder, "job.json")
        job.write_text(
            json.dumps(
                {
                    "folder": folder,
                    "root": str(root),
                    "cwd": os.getcwd(),
                    "command": [
                        sys.executable,
                        "-m",
                        "pytest",
                        "-p",
                        "no:cacheprovider",
                        *arguments,
                    ],
                    "environment": {
                        **os.environ,
                        "TERM": "dumb",
                        "PATH": f"{root}/usr/bin:{os.environ['PATH']}",
                    },
                }
            )
        )
        command = [
            str(root / "usr/bin/linux.uml"),
            *("root=/dev/root", "rootfstype=hostfs", "rootflags=/", "rw", "mem=1024M"),
            *(f"uml_dir={folder}/", "con=null", "con0=null,fd:1", "quiet", "loglevel=3"),
            f"init={sys.executable}",
            *("--", __file__, str(job)),
        ]
        subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            timeout=TIMEOUT,
            check=False,
            preexec_fn=end_with_parent,
        )
        code = Path(folder, "code")
        if not code.exists():
            raise SystemExit(f"it ended early: {shlex.join(command)}")
        return int(code.read_text())


def end_with_parent() -> None:
    """Have the kernel halt when the process that started it is killed."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def be_init(job: Path) -> None:
    """Be the first process of the kernel: mount, load, run, write the exit code, power off."""
    libc = ctypes.CDLL(None, use_errno=True)
    code = 3
    folder = Path()
    try:
        given = json.loads(job.read_text())
        folder = Path(given["folder"])
        for kind, place in MOUNTS:
            os.makedirs(place, exist_ok=True)
            if libc.mount(kind.encode(), place.encode(), kind.encode(), 0, None):
                raise OSError(ctypes.get_errno(), f"mount {place}")
        modules = Path(given["root"], "usr/lib/uml/modules", platform.release(), "kernel")
        for name in MODULES:
            with next(modules.rglob(f"{name}.ko")).open("rb") as file:
                if libc.syscall(SYS_FINIT_MODULE, file.fileno(), b"", 0):
                    raise OSError(ctypes.get_errno(), f"module {name}")
        for command in (
            "ip link set lo up",
            "ip link add vcan0 type vcan",
            "ip link set vcan0 up",
        ):
            subprocess.run(command.split(), env=given["environment"], check=True)
        code = subprocess.run(
            given["command"], cwd=given["cwd"], env=given["environment"], check=False
        ).returncode
    except BaseException:
        traceback.print_exc()
    finally:
        Path(folder, "code").write_text(str(code))
        os.sync()
        libc.syscall(SYS_REBOOT, *REBOOT)


if __name__ == "__main__":
    if os.getpid() == 1:
        be_init(Path(sys.argv[1]))
    given = sys.argv[1:]
    names_files = any(Path(argument.partition("::")[0]).exists() for argument in given)
    sys.exit(start(unpack(CACHE), given if names_files else [*given, str(TESTS)]))
