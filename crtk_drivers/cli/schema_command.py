"""``crtk-driver schema <device>``: its configuration as a JSON schema, or as a table for people."""

from __future__ import annotations

import json
from typing import Annotated, Any, Final

import typer

from crtk_drivers import plugins
from crtk_drivers.cli.config_reference import device_tables, table_of
from crtk_drivers.cli.help_pages import HelpfulCommand, completed_from
from crtk_drivers.cli.terminal import OUT
from crtk_drivers.config import with_node
from crtk_drivers.labs.lab_file import LabSettings

app = typer.Typer()

LAB: Final = "lab"
"""What is asked for instead of a device, for the schema of a lab file."""


@app.command("schema", cls=HelpfulCommand)
def _schema(
    name: Annotated[
        str,
        typer.Argument(
            help="Of the device; lab: of a lab file.",
            autocompletion=completed_from(lambda: (*plugins.devices(), LAB)),
        ),
    ],
    markdown: Annotated[bool, typer.Option("--markdown", help="As tables for people.")] = False,
) -> None:
    """Print the JSON schema of a device's configuration."""
    print_schema(name, markdown)


def print_schema(name: str, markdown: bool) -> None:
    """Print it: coloured on a terminal, otherwise nothing but JSON or Markdown.

    Raises:
        PluginError, MissingExtra: see `crtk_drivers.plugins.device`.
    """
    model: Any
    if name == LAB:
        tables, model = table_of(LabSettings), LabSettings
    else:
        plugin = plugins.device(name)
        tables, model = device_tables(plugin), with_node(plugin.config)
    if markdown:
        typer.echo(tables, nl=False)
        return
    text = json.dumps(model.model_json_schema(), indent=2, ensure_ascii=False)
    if OUT.is_terminal:
        OUT.print_json(text)
    else:
        typer.echo(text)
