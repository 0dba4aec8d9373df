"""A release: versions agree, archives hold what they should, workflows call scripts that exist."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[2]
CI = ROOT / ".ci"

with patch.object(sys, "path", [str(CI), *sys.path]):
    import archives
    import versions

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
STATED = [(folder, each) for folder, all_ in versions.STATEMENTS.items() for each in all_]


def project(folder: str) -> Mapping[str, Any]:
    read = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())
    return dict(read["project"])


# Versions


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """The files that state a version, in a folder of their own."""
    names = [each.file for _, each in STATED]
    names += [f"{folder}/pyproject.toml" for folder in versions.STATEMENTS]
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def test_every_version_is_that_of_its_pyproject() -> None:
    assert list(versions.differences(ROOT)) == []


@pytest.mark.parametrize(("folder", "stated"), STATED, ids=[each.file for _, each in STATED])
def test_a_version_that_differs_is_found(
    folder: str, stated: versions.Statement, tree: Path
) -> None:
    file = tree / stated.file
    file.write_text(file.read_text().replace(versions.version(tree, folder), "7.7.7", 1))
    (line,) = versions.differences(tree)
    assert line.startswith(f"{stated.file} states 7.7.7")


def test_a_version_is_stated_nowhere_else() -> None:
    """`crtk_drivers` asks its metadata."""
    files = [*ROOT.glob("docs/*.md"), *ROOT.glob("crtk_drivers/*.py"), ROOT / "README.md"]
    number = re.compile(rf"(?<![\d.]){re.escape(versions.version(ROOT))}(?![\d.])")
    assert [str(file) for file in files if number.search(file.read_text())] == []


def test_a_tag_must_be_the_version_and_released(tree: Path) -> None:
    own = versions.version(tree)
    changes = tree / "CHANGELOG.md"
    assert any("unreleased" in line for line in versions.tag_differences(tree, f"v{own}"))
    changes.write_text(changes.read_text().replace(f"Unreleased ({own})", f"{own}, 2027-01-31"))
    assert list(versions.differences(tree)) == []
    assert list(versions.tag_differences(tree, f"v{own}")) == []
    (line,) = versions.tag_differences(tree, "v7.7.7")
    assert line.endswith(f"its tag is v{own}")


def test_extras_ask_for_the_messages_of_this_repository() -> None:
    own = {project(folder)["name"]: versions.version(ROOT, folder) for folder in versions.MESSAGES}
    extras = project(".")["optional-dependencies"]
    asked = [
        Requirement(each) for name in ("ros", "moveit", "ros2-control") for each in extras[name]
    ]
    ours = [each for each in asked if each.name in own]
    assert sorted(each.name for each in ours) == sorted(own)
    for each in ours:
        assert each.specifier.contains(own[each.name])


@pytest.mark.parametrize("folder", versions.STATEMENTS)
def test_wheels_are_built_for_every_python_that_is_supported(folder: str) -> None:
    (listed,) = re.findall(r"^all_pythons=\((.*?)\)", (CI / "release").read_text(), re.MULTILINE)
    supported = SpecifierSet(project(folder)["requires-python"])
    assert listed.split() == [f"3.{n}" for n in range(30) if supported.contains(f"3.{n}.0")]


# The script


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone of what the script needs before it builds anything."""
    if shutil.which("git") is None:
        pytest.skip("needs git")
    folder = tmp_path / "clone"
    folder.mkdir()
    for name in ("CHANGELOG.md", "CITATION.cff", "pyproject.toml", ".gitignore"):
        shutil.copy(ROOT / name, folder)
    for name in versions.MESSAGES:
        (folder / name).mkdir()
        for file in ("pyproject.toml", "package.xml", "CMakeLists.txt"):
            shutil.copy(ROOT / name / file, folder / name)
    (folder / ".ci").mkdir()
    for name in ("release", "versions.py", "archives.py", "steps.sh"):
        shutil.copy(CI / name, folder / ".ci")
    git = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b.example"]
    for command in (["init", "--quiet"], ["add", "--all"], ["commit", "--quiet", "--message=a"]):
        subprocess.run([*git, *command], check=True)
    return folder


def release(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Call the script, which leaves no byte code in the clone."""
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        ["bash", str(folder / ".ci" / "release"), *arguments],
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_the_script_helps() -> None:
    done = release(ROOT, "--help")
    assert done.returncode == 0, done.stderr
    for option in ("--out", "--tag", "--python"):
        assert option in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--tag"], "--tag needs a value"),
        (["--python", "3.9"], "not one of 3.11"),
        (["--all"], "--all is no option"),
        (["--tag", "v7.7.7"], "the tag is v7.7.7"),
        (["--out", ".ci"], ".ci is not empty"),
    ],
)
def test_what_cannot_be_released_is_refused(arguments: list[str], said: str, clone: Path) -> None:
    done = release(clone, *arguments)
    assert done.returncode == 1
    assert said in done.stderr
    assert done.stdout == ""


def test_a_changed_clone_is_refused(clone: Path) -> None:
    (clone / "notes.txt").touch()
    done = release(clone)
    assert done.returncode == 1
    assert "notes.txt" in done.stderr
    assert "this clone has changes" in done.stderr


# Archives


def write_source(archive: Path, *names: str, link: tuple[str, str] | None = None) -> Path:
    """Write a source distribution of empty files, and a link."""
    with tarfile.open(archive, "w:gz") as tar:
        for name in names:
            tar.addfile(tarfile.TarInfo(f"x-1/{name}"))
        if link:
            member = tarfile.TarInfo(f"x-1/{link[0]}")
            member.type, member.linkname = tarfile.SYMTYPE, link[1]
            tar.addfile(member)
    return archive


def write_wheel(archive: Path, files: Mapping[str, bytes]) -> Path:
    with zipfile.ZipFile(archive, "w") as wheel:
        for name, content in files.items():
            wheel.writestr(name, content)
    return archive


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "source" / "a_msgs"
    folder.mkdir(parents=True)
    for name in ("wheel.cmake", "pyproject.toml"):
        (folder / name).touch()
    return folder


def test_a_whole_source_distribution_is_right(package: Path, tmp_path: Path) -> None:
    archive = write_source(tmp_path / "a.tar.gz", "wheel.cmake", "pyproject.toml", "PKG-INFO")
    assert list(archives.source_complaints(archive, package)) == []


def test_junk_in_a_source_distribution_is_named(package: Path, tmp_path: Path) -> None:
    names = ("wheel.cmake", "pyproject.toml", "a/__pycache__/b.pyc")
    archive = write_source(tmp_path / "a.tar.gz", *names)
    (line,) = archives.source_complaints(archive, package)
    assert "holds a/__pycache__/b.pyc" in line


def test_what_a_source_distribution_lacks_is_named(package: Path, tmp_path: Path) -> None:
    archive = write_source(tmp_path / "a.tar.gz", "pyproject.toml")
    assert list(archives.source_complaints(archive, package)) == ["a.tar.gz lacks wheel.cmake"]


def test_a_link_out_of_a_source_distribution_is_named(package: Path, tmp_path: Path) -> None:
    link = ("wheel.cmake", "../crtk_msgs/wheel.cmake")
    archive = write_source(tmp_path / "a.tar.gz", "pyproject.toml", link=link)
    (line,) = archives.source_complaints(archive, package)
    assert "holds wheel.cmake as a link" in line


def test_the_wheel_must_hold_its_packages(tmp_path: Path) -> None:
    (tmp_path / "drivers" / "a" / "crtk_driver_a").mkdir(parents=True)
    (tmp_path / "drivers" / "a" / "crtk_driver_a" / "device.py").touch()
    packages = '[tool.hatch.build.targets.wheel]\npackages = ["drivers/a/crtk_driver_a"]\n'
    (tmp_path / "pyproject.toml").write_text(packages)
    good = {"crtk_driver_a/device.py": b"", "c-1.dist-info/METADATA": b""}
    archive = write_wheel(tmp_path / "c.whl", good)
    assert list(archives.root_wheel_complaints(archive, tmp_path)) == []
    archive = write_wheel(tmp_path / "c.whl", {"crtk_driver_a/tests/test_a.py": b""})
    assert len(list(archives.root_wheel_complaints(archive, tmp_path))) == 2


@pytest.mark.parametrize(
    ("platform", "file", "content", "said"),
    [
        ("manylinux_2_28_x86_64", "lib/liba_msgs__x.so", b"", None),
        ("manylinux_2_28_x86_64", "lib/python3.11/a_msgs_s__x.so", b"", None),
        ("linux_x86_64", "lib/liba_msgs__x.so", b"", "is not for manylinux"),
        ("manylinux_2_28_x86_64", "a.libs/libfastcdr-7f.so.2", b"", "of another package"),
        ("manylinux_2_28_x86_64", "share/a.sh", b"cd /tmp/x", "machine that built it"),
    ],
)
def test_a_message_wheel_must_fit_other_machines(
    platform: str, file: str, content: bytes, said: str | None, tmp_path: Path
) -> None:
    archive = write_wheel(tmp_path / f"a_msgs-1-cp311-cp311-{platform}.whl", {file: content})
    found = list(archives.message_wheel_complaints(archive, "a_msgs"))
    assert len(found) == (0 if said is None else 1)
    assert said is None or said in found[0]


# Workflows


def steps(workflow: Path) -> Iterator[Mapping[str, Any]]:
    for job in yaml.safe_load(workflow.read_text())["jobs"].values():
        yield from job["steps"]


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_calls_scripts_that_exist(workflow: Path) -> None:
    lines = [line for step in steps(workflow) for line in step.get("run", "").splitlines()]
    called = [name for line in lines for name in re.findall(r"bash \.ci/(\S+)", line)]
    assert called
    assert all((CI / name).is_file() for name in called)
    others = [line for line in lines if "bash .ci/" not in line]
    assert all(line.startswith(("sudo apt-get ", "gh release create ")) for line in others)


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_pins_its_actions(workflow: Path) -> None:
    used = [step["uses"] for step in steps(workflow) if "uses" in step]
    assert all(re.search(r"@(release/)?v\d+$", each) for each in used)


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_may_only_read_unless_a_job_says_more(workflow: Path) -> None:
    assert yaml.safe_load(workflow.read_text())["permissions"] == {"contents": "read"}


def test_every_suite_of_the_bare_workflow_is_known() -> None:
    bare = yaml.safe_load((ROOT / ".github" / "workflows" / "bare.yml").read_text())
    suites = bare["jobs"]["bare"]["strategy"]["matrix"]["suite"]
    usage = re.search(r"usage: bash \.ci/bare (\S+)", (CI / "bare").read_text())
    assert usage is not None
    assert suites == usage[1].split("|")


def test_no_page_asks_an_index_for_crtk_drivers() -> None:
    """None has it. What installs it from elsewhere is on one page."""
    pages = [*ROOT.glob("docs/*.md"), *ROOT.glob("*.md"), *ROOT.glob("examples/**/*.md")]
    asking = re.compile(r"pip install (?!--no-index)[^`\n]*(?<![./\w-])crtk-drivers\b")
    naming = {page.name for page in pages if asking.search(page.read_text())}
    assert naming <= {"CHANGELOG.md", "installing.md"}
    assert "on no package index" in (ROOT / "docs" / "installing.md").read_text()
