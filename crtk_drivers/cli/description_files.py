"""What is told of plugins before they are imported: writes the files beside their entry points.

python -m crtk_drivers.cli.description_files             # writes those of this distribution
python -m crtk_drivers.cli.description_files my_arm      # writes those of the plugins of that name
python -m crtk_drivers.cli.description_files --check     # 1 if one is out of date

See `crtk_drivers.plugins.description`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from crtk_drivers import plugins
from crtk_drivers.cli.written_files import write_or_check, writer_parser
from crtk_drivers.errors import PluginError
from crtk_drivers.plugins import PluginEntry
from crtk_drivers.plugins.description import FILE, package_folders

Content = dict[str, dict[str, Any]]


def files_of(entries: Sequence[PluginEntry]) -> Mapping[Path, str]:
    """Return the files that describe plugins, each as it should be; what else they describe stays.

    Raises:
        PluginError, MissingExtra: one of them cannot be loaded.
    """
    contents: dict[Path, Content] = {}
    for entry in entries:
        folders = package_folders(entry.entry_point)
        if not folders:
            raise PluginError(
                f"{entry.entry_point.value} is in no package, beside which its description could be",
                remedy="Make its module a package: a folder with an __init__.py.",
            )
        path = folders[0] / FILE
        if path not in contents:
            contents[path] = json.loads(path.read_text("utf-8")) if path.exists() else {}
        told = {key: text for key, text in asdict(plugins.described(entry.plugin)).items() if text}
        contents[path].setdefault(entry.entry_point.group, {})[entry.name] = told
    return {path: _text(content) for path, content in contents.items()}


def _text(content: Content) -> str:
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def _chosen(names: Sequence[str]) -> Iterator[PluginEntry]:
    for entries in (plugins.devices(), plugins.sims(), plugins.pages()):
        for name, entry in entries.items():
            if name in names or (not names and entry.distribution == plugins.OWN_DISTRIBUTION):
                yield entry


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files, or check them; return the exit code."""
    module = __spec__.name
    parser = writer_parser(module, "Descriptions of plugins, beside their entry points.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="of plugins; ours without")
    options = parser.parse_args(arguments)
    entries = list(_chosen(options.names))
    for name in options.names:
        if not any(entry.name == name for entry in entries):
            parser.error(f"there is no plugin {name!r}")
    return write_or_check(
        files_of(entries), only_check=options.check, module=module, given=options.names
    )


if __name__ == "__main__":
    sys.exit(main())
