"""Makes a plugin importable as `pip install -e` does: its sources, and metadata with its entry points."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

LONG = 280
"""Seconds that anything may take in the environment of a plugin."""


def install(plugin: Path, where: Path) -> dict[str, str]:
    """Write the metadata of a plugin into the folder `where`; return the environment that finds it."""
    project = tomllib.loads((plugin / "pyproject.toml").read_text())["project"]
    info = where / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir(parents=True)
    metadata = f"Metadata-Version: 2.4\nName: {project['name']}\nVersion: {project['version']}\n"
    (info / "METADATA").write_text(metadata)
    groups = project["entry-points"]
    lines = [
        line
        for group, entries in groups.items()
        for line in (f"[{group}]", *(f"{name} = {target}" for name, target in entries.items()), "")
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))
    paths = [str(plugin / "src"), str(where), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}


def run(folder: Path, environment: dict[str, str], *arguments: str) -> str:
    """Run Python there with `arguments`, which must end well; return what it wrote."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=LONG,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
