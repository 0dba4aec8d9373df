"""Check what a release's archives hold: python3 .ci/archives.py SOURCE DIST

SOURCE is an export of the repository, DIST the folder of source distributions and wheels. A source
distribution must hold the files of its package, all of them, and nothing else. The wheel of crtk-drivers must
hold the packages that pyproject.toml names, likewise. The wheel of a message package must fit other machines:
it has a tag that an index accepts, no library of another package, and no path of the machine that built it.
"""

import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator, Set
from pathlib import Path

from versions import MESSAGES

BUILDERS = (b"/tmp/", b"/home/", b"/root/", b"/__w/")
"""How paths of a machine that builds begin."""
PLATFORM = "manylinux_2_28_x86_64"
"""That of the ROS wheels, without which no message package is of use."""


def files(folder: Path) -> Set[str]:
    """Return the files below a folder, links among them, by their paths from there."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}


def compare(archive: Path, held: Set[str], wanted: Set[str]) -> Iterator[str]:
    """Yield a line for each file that an archive lacks, or should not hold."""
    for name in sorted(wanted - held):
        yield f"{archive.name} lacks {name}"
    for name in sorted(held - wanted):
        yield f"{archive.name} holds {name}, which is none of its package's"


def source_complaints(archive: Path, folder: Path) -> Iterator[str]:
    """Yield what is wrong with the source distribution of the package in a folder."""
    with tarfile.open(archive) as tar:
        members = [each for each in tar.getmembers() if not each.isdir()]
    held = {each.name.partition("/")[2]: each for each in members}
    yield from compare(archive, held.keys() - {"PKG-INFO"}, files(folder))
    for name, each in held.items():
        target = (folder / name).parent / each.linkname
        if each.issym() and not target.resolve().is_relative_to(folder.resolve()):
            yield f"{archive.name} holds {name} as a link that leads out of it"


def root_wheel_complaints(archive: Path, folder: Path) -> Iterator[str]:
    """Yield what is wrong with the wheel of crtk-drivers."""
    build = tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))["tool"]["hatch"]["build"]
    wanted = {
        str(Path(Path(package).name, name))
        for package in build["targets"]["wheel"]["packages"]
        for name in files(folder / package)
    }
    with zipfile.ZipFile(archive) as wheel:
        held = {name for name in wheel.namelist() if ".dist-info/" not in name}
    yield from compare(archive, held, wanted)


def message_wheel_complaints(archive: Path, package: str) -> Iterator[str]:
    """Yield what is wrong with the wheel of a message package."""
    if not archive.stem.endswith(f"-{PLATFORM}"):
        yield f"{archive.name} is not for {PLATFORM}"
    with zipfile.ZipFile(archive) as wheel:
        for name in wheel.namelist():
            library = name.rpartition("/")[2]
            if ".so" in library and not library.startswith((f"lib{package}__", f"{package}_s__")):
                yield f"{archive.name} holds {name}, a library of another package"
            content = wheel.read(name)
            for path in BUILDERS:
                if path in content:
                    yield f"{archive.name}: {name} has a path of the machine that built it ({path!r})"


def complaints(source: Path, dist: Path) -> Iterator[str]:
    """Yield what is wrong with the archives in a folder."""
    for archive in dist.glob("crtk_drivers-*.tar.gz"):
        yield from source_complaints(archive, source)
    for archive in dist.glob("crtk_drivers-*.whl"):
        yield from root_wheel_complaints(archive, source)
    for package in MESSAGES:
        name = f"crtk_{package.removeprefix('crtk_')}"
        for archive in dist.glob(f"{name}-*.tar.gz"):
            yield from source_complaints(archive, source / package)
        for archive in dist.glob(f"{name}-*.whl"):
            yield from message_wheel_complaints(archive, package)


if __name__ == "__main__":
    found = list(complaints(*map(Path, sys.argv[1:])))
    if found:
        sys.exit("\n".join(found))
    print("Every archive holds what its package has, and nothing else")
