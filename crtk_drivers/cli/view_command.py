"""``crtk-driver view``: the devices on the graph, of any maker, in a browser or on a terminal."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.reaching import Interrupted, interruptible, prepare
from crtk_drivers.cli.terminal import ERR, OUT
from crtk_drivers.errors import ConfigError, ConnectionLost

if TYPE_CHECKING:
    from crtk_drivers.client.view.shown import Mounted
    from crtk_drivers.client.view.watcher import Watcher

app = typer.Typer()

DEFAULT_PORT = 8000
TERMINAL_WAIT = 5.0
"""Seconds in which devices are looked for where there is no terminal to show them later."""


@app.command("view", cls=HelpfulCommand)
def _view(
    devices: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="DEVICES...",
            help="Namespaces, or a lab file; without them, all devices that appear.",
            show_default=False,
        ),
    ] = None,
    terminal: Annotated[
        bool, typer.Option("--terminal", help="A live table on this terminal, not a page.")
    ] = False,
    port: Annotated[
        int,
        typer.Option(
            "--port", min=0, max=65535, help="Of the page, at 127.0.0.1; 0: any free one."
        ),
    ] = DEFAULT_PORT,
    control: Annotated[
        bool,
        typer.Option(
            "--control",
            help="Whoever has the address that is told may enable, disable, hold, jog and move devices.",
        ),
    ] = False,
) -> None:
    """Show devices of any maker while they run: arms in 3-D, values over time, states, health, refusals.

    Examples:

        crtk-driver view
        crtk-driver view /ur5 /ft --control
        crtk-driver view lab.toml --terminal
    """
    if terminal and control:
        raise ConfigError(
            "is for the page",
            where="--control",
            remedy="Leave out --terminal; in a terminal, crtk-driver hold, enable and move command.",
        )
    prepare()
    from crtk_drivers.client.view.watcher import Watcher, wanted

    found = wanted(devices or ())
    try:
        with interruptible(), Watcher(found.namespaces) as watcher:
            if not terminal:
                _serve(watcher, found.mounted, port, control)
            from crtk_drivers.cli.terminal_view import TerminalView

            if not OUT.is_terminal:
                watcher.wait(TERMINAL_WAIT)
            TerminalView(watcher).run(OUT)
    except Interrupted:
        raise typer.Exit from None


def _serve(watcher: Watcher, mounted: Mounted, port: int, control: bool) -> NoReturn:
    """Serve the page until this process is interrupted."""
    from crtk_drivers import plugins
    from crtk_drivers.client.view.shown import ShownDevices
    from crtk_drivers.plugins.page_plugin import start_page

    plugin = plugins.page("view")
    with closing(ShownDevices(watcher, mounted, control)) as shown:
        page = start_page(plugin, shown, port)
        try:
            secret = "" if shown.secret is None else f"#{shown.secret}"
            if control:
                ERR.print(
                    "[yellow]Whoever has this address may move the devices. "
                    "Its hold is no emergency stop.[/]"
                )
            OUT.print(f"{page.address}{secret}", soft_wrap=True)
            shown.is_over.wait()
            raise ConnectionLost(
                "the server of the page has ended",
                where=page.address,
                remedy="Start the view again.",
            )
        finally:
            page.stop()
