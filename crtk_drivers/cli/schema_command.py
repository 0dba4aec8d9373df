"""``crtk-driver schema <device>``: its configuration as a JSON schema, or as a table for people."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from crtk_drivers import plugins
from crtk_drivers.cli.config_reference import device_tables
from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.terminal import OUT
from crtk_drivers.config import with_node

app = typer.Typer()


@app.command("schema", cls=HelpfulCommand)
def _schema(
    name: Annotated[str, typer.Argument(help="Of the device.")],
    markdown: Annotated[bool, typer.Option("--markdown", help="As tables for people.")] = False,
) -> None:
    """Print the JSON schema of a device's configuration."""
    print_schema(name, markdown)


def print_schema(name: str, markdown: bool) -> None:
    """Print it: coloured on a terminal, otherwise nothing but JSON or Markdown.

    Raises:
        PluginError, MissingExtra: see `crtk_drivers.plugins.device`.
    """
    plugin = plugins.device(name)
    if markdown:
        typer.echo(device_tables(plugin), nl=False)
        return
    text = json.dumps(with_node(plugin.config).model_json_schema(), indent=2, ensure_ascii=False)
    if OUT.is_terminal:
        OUT.print_json(text)
    else:
        typer.echo(text)
