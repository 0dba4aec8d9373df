"""What the site (mkdocs.yml) needs beside the pages: the API reference, pages and links of the root."""

import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]

FROM_ROOT = {
    "index.md": "README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changes.md": "CHANGELOG.md",
}
"""Pages of the site that lie beside docs/, not in it."""

_ON_SITE = {source: name for name, source in FROM_ROOT.items()}

API = {
    "python": ("Devices in Python", ["crtk_drivers.front.local", "crtk_drivers.motion.move"]),
    "client": ("The far side of ROS", ["crtk_drivers.client.remote"]),
    "device": (
        "What a plugin implements",
        [
            "crtk_drivers.device.interface",
            "crtk_drivers.device.capabilities",
            "crtk_drivers.device.values",
            "crtk_drivers.device.extras",
            "crtk_drivers.plugins",
        ],
    ),
    "values": (
        "Values, states, errors",
        ["crtk_drivers.samples", "crtk_drivers.state", "crtk_drivers.errors"],
    ),
    "config": (
        "Configuration",
        ["crtk_drivers.config.settings", "crtk_drivers.config.layers"],
    ),
    "testing": ("Testing a plugin", ["crtk_drivers.testing.contract"]),
}
"""Pages of the API reference: title, and the modules whose docstrings they show."""

_LINK = re.compile(r"(!?)\[([^\]]+)\]\((?!https?:)([^)\s#]*)(#[^)\s]*)?\)")


def on_files(files, config):
    """Add what is not a file in docs/."""
    for name, source in FROM_ROOT.items():
        text = (ROOT / source).read_text("utf-8")
        files.append(File.generated(config, name, content=text))
    for name, (title, modules) in API.items():
        shown = "\n\n".join(f"::: {module}" for module in modules)
        files.append(File.generated(config, f"api/{name}.md", content=f"# {title}\n\n{shown}\n"))
    return files


def on_page_markdown(markdown, page, config, files):
    """Let links lead to pages of the site; what is in the repository only is named, not linked."""
    name = page.file.src_uri
    source = posixpath.dirname(FROM_ROOT.get(name, f"docs/{name}"))
    here = posixpath.dirname(name) or "."

    def lead(match):
        picture, text, path, anchor = match.groups()
        if not path:
            return match.group(0)
        target = posixpath.normpath(posixpath.join(source, path))
        on_site = _ON_SITE.get(target) or (target[5:] if target.startswith("docs/") else "")
        if on_site and files.get_file_from_path(on_site):
            return f"{picture}[{text}]({posixpath.relpath(on_site, here)}{anchor or ''})"
        return f"{text} (`{target}` in the repository)"

    return _LINK.sub(lead, markdown)
