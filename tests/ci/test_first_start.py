"""The script of a clone: what it has uv do, and what it says of a system that lacks something."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
MESSAGES = ("control_msgs", "controller_manager_msgs", "crtk_msgs", "tf2_msgs")
FAKE_UV = """#!/bin/sh
if [ "$1 $2" = "python find" ]; then echo "$PYTHON_FOUND"; else echo "$CRTK_DRIVER_SCRIPT uv $*"; fi
"""
APT = "sudo apt install python3-venv python3-dev g++"


def write_program(path: Path, script: str) -> None:
    path.write_text(script)
    path.chmod(0o755)


class Clone:
    """A clone with nothing set up, on a machine that has no more than its folder `bin`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "clone"
        self.bin = folder / "bin"
        (self.folder / "crtk_msgs").mkdir(parents=True)
        self.bin.mkdir()
        shutil.copy(ROOT / "crtk-driver", self.folder)
        shutil.copy(ROOT / "crtk_msgs" / "build_needs.py", self.folder / "crtk_msgs")
        for program in ("sh", "readlink", "dirname", "uname", "mktemp", "mkdir", "mv", "rm"):
            self.has(program)

    def has(self, program: str, target: str | None = None) -> None:
        """Install a program: this machine's, or `target`."""
        found = target or shutil.which(program)
        assert found
        (self.bin / program).symlink_to(found)

    def has_uv(self, script: str = FAKE_UV, *, set_up: bool = True) -> None:
        """Install a uv, which says what it is asked for if no other `script` is given."""
        write_program(self.bin / "uv", script)
        if set_up:
            (self.folder / ".venv").mkdir()

    def start(
        self, *arguments: str, cwd: Path | None = None, **variables: str
    ) -> subprocess.CompletedProcess[str]:
        """Start the script, by a path from the folder `cwd`."""
        cwd = cwd or self.folder
        path = os.path.relpath(self.folder / "crtk-driver", cwd)
        return subprocess.run(
            [path if "/" in path else f"./{path}", *arguments],
            cwd=cwd,
            env={"PATH": str(self.bin), "PYTHON_FOUND": sys.executable, **variables},
            capture_output=True,
            text=True,
            timeout=60,
        )


@pytest.fixture
def clone(tmp_path: Path) -> Clone:
    return Clone(tmp_path)


@pytest.mark.parametrize(
    ("given", "asked"),
    [
        ("ur --ns /ur5 --sim", "run --project {} crtk-driver ur --ns /ur5 --sim"),
        ("--help", "run --project {} crtk-driver --help"),
        ("", "run --project {} crtk-driver"),
        ("--extra=a --extra b virtual", "run --project {} --extra a --extra b crtk-driver virtual"),
        (
            "--test -k ur --extra",
            "run --project {0} --directory {0} --group test pytest -k ur --extra",
        ),
        ("--pip install -e x", "pip install -e x"),
    ],
)
def test_the_script_asks_uv(clone: Clone, given: str, asked: str) -> None:
    clone.has_uv()
    done = clone.start(*given.split())
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == f"./crtk-driver uv {asked.format(clone.folder)}"


def test_the_script_starts_from_any_folder(clone: Clone) -> None:
    clone.has_uv()
    done = clone.start("list", cwd=clone.bin)
    assert done.stdout == f"../clone/crtk-driver uv run --project {clone.folder} crtk-driver list\n"


def test_arguments_stay_as_they_are(clone: Clone) -> None:
    clone.has_uv('#!/bin/sh\nfor each; do echo "<$each>"; done\n')
    done = clone.start("move", "a b", "*", "")
    assert done.stdout.splitlines()[-4:] == ["<move>", "<a b>", "<*>", "<>"]


def test_what_is_run_has_the_scripts_path(clone: Clone) -> None:
    clone.has_uv()
    done = clone.start("--run", "python", "x.py", "--test")
    asked = f"uv run --project {clone.folder} python x.py --test"
    assert done.stdout == f"{clone.folder}/crtk-driver {asked}\n"


@pytest.mark.parametrize("given", ["--extra", "--extra=", "--extra * list", "--run"])
def test_an_option_without_a_value_is_refused(clone: Clone, given: str) -> None:
    clone.has_uv()
    done = clone.start(*given.split())
    assert done.returncode == 1
    assert done.stdout == ""
    assert given.partition("=")[0].split()[0] in done.stderr


def test_a_broken_uv_is_passed_over(clone: Clone) -> None:
    (clone.bin / "uv").symlink_to("/bin/false")
    own = clone.folder / ".uv" / "uv"
    own.parent.mkdir()
    write_program(own, FAKE_UV)
    (clone.folder / ".venv").mkdir()
    assert "crtk-driver list" in clone.start("list").stdout


def test_settings_of_other_environments_do_not_count(clone: Clone) -> None:
    clone.has_uv('#!/bin/sh\necho "$VIRTUAL_ENV$UV_SYSTEM_PYTHON $UV_PYTHON $1"\n')
    foreign = {"VIRTUAL_ENV": "/other", "UV_SYSTEM_PYTHON": "1", "UV_PYTHON": "/usr/bin/python3"}
    done = clone.start("--pip", "list", **foreign)
    assert done.stdout.splitlines()[-1] == f" {clone.folder}/.venv pip"


def test_a_system_without_python_is_told_all_at_once(clone: Clone) -> None:
    done = clone.start("ur", "--sim")
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.endswith(APT)


def test_a_missing_compiler_is_said_before_set_up(clone: Clone) -> None:
    clone.has_uv(set_up=False)
    clone.has("apt", "/bin/true")
    done = clone.start("ur", "--sim")
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert (
        line == "crtk-driver: a C++ compiler is missing. Install what is missing: apt install g++"
    )


def test_a_system_that_has_all_is_set_up(clone: Clone) -> None:
    clone.has_uv(set_up=False)
    clone.has("cc", "/bin/true")
    clone.has("c++", "/bin/true")
    done = clone.start("ur", "--sim")
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("crtk-driver ur --sim\n")


def test_another_machine_than_x86_64_is_refused(clone: Clone) -> None:
    clone.has_uv()
    (clone.bin / "uname").unlink()
    write_program(clone.bin / "uname", "#!/bin/sh\necho aarch64\n")
    done = clone.start("ur")
    assert done.returncode == 1
    assert "aarch64" in done.stderr


@pytest.fixture
def needs() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "build_needs", ROOT / "crtk_msgs" / "build_needs.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # which dataclasses look up
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def bare(needs: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A system without compiler and headers, whose programs are those of a folder."""
    monkeypatch.setattr(needs.sysconfig, "get_path", lambda name: str(tmp_path / name))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("CXX", raising=False)
    return tmp_path


def install(folder: Path, *programs: str) -> None:
    for program in programs:
        (folder / program).symlink_to("/bin/true")


@pytest.mark.parametrize(
    ("manager", "command"),
    [
        ("apt", r"missing: apt install python3[\d.]*-dev g\+\+"),
        ("dnf", r"missing: dnf install python3-devel gcc-c\+\+"),
        ("pacman", "Install what is missing"),
    ],
)
def test_each_package_manager_has_its_names(
    manager: str, command: str, needs: ModuleType, bare: Path
) -> None:
    install(bare, manager)
    said = needs.complaint(("compiler", "headers"))
    assert f"Python.h of {needs.PYTHON} and a C++ compiler are missing" in said
    assert re.search(command, said), said


def test_sudo_is_named_where_it_is_needed(
    needs: ModuleType, bare: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(bare, "apt", "sudo")
    monkeypatch.setattr(needs.os, "geteuid", lambda: 1000)
    assert "missing: sudo apt install g++" in needs.complaint(("compiler",))


def test_compilers_of_the_variables_count(
    needs: ModuleType, bare: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(bare, "my-cc")
    assert needs.complaint(("compiler",))
    monkeypatch.setenv("CC", "my-cc -m64")
    monkeypatch.setenv("CXX", "my-cc -m64")
    assert needs.complaint(("compiler",)) == ""


@pytest.mark.parametrize("package", MESSAGES)
def test_every_message_package_is_built_by_the_same_backend(package: str) -> None:
    for file in ("build_backend.py", "build_needs.py", "wheel.cmake"):
        assert (ROOT / package / file).resolve() == ROOT / "crtk_msgs" / file
