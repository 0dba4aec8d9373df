"""The commands that use a running CRTK device over ROS 2, whoever made it.

They are a small client on `crtk_drivers.client`, for a terminal: `ros2` is not needed.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import Annotated, Final

import typer

from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.own_commands import OWN_COMMANDS
from crtk_drivers.cli.reaching import (
    FIND_TIMEOUT,
    Namespace,
    Timeout,
    held_when_interrupted,
    need,
    prepare,
    reached,
)
from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.errors import ConfigError
from crtk_drivers.state import StateCommand

_NUMBERS: Final = {"ignore_unknown_options": True}
"""So that ``-1.3`` is a value; what begins with two dashes is refused by `_no_options`."""

app = typer.Typer()

Child = Annotated[
    str,
    typer.Option("--child", metavar="NAME", help="A part of the device: jaw, gripper."),
]


def _no_options(values: list[str] | None) -> list[str]:
    """Return the values, among which there may be no option that was misspelt."""
    for value in values or ():
        if value.startswith("--"):
            raise ConfigError("no such option", where=value, remedy="See --help.")
    return values or []


def _help(name: str) -> str:
    return f"{OWN_COMMANDS[name].summary}\n\nExample:\n\n    crtk-driver {name} /ur5"


@app.command("state", cls=HelpfulCommand)
def _state(
    namespace: Annotated[
        str,
        typer.Argument(metavar="NAMESPACE", help="Of the device; all devices without it."),
    ] = "",
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Show how a device is, why, and where it stands; without NAMESPACE, which devices there are.

    Examples:

        crtk-driver state
        crtk-driver state /ur5
    """
    from crtk_drivers.cli.state_view import print_all, print_device

    if not namespace:
        prepare()
        raise typer.Exit(print_all())
    with reached(namespace, timeout) as device:
        raise typer.Exit(print_device(device))


def _state_command(command: StateCommand) -> Callable[..., None]:
    def run(namespace: Namespace, timeout: Timeout = FIND_TIMEOUT) -> None:
        from crtk_drivers.cli.state_view import explained, status_words
        from crtk_drivers.client.state_commands import home_to_its_end

        with reached(namespace, timeout) as device:
            with ERR.status(f"{command} {plain(device.namespace)} ..."), explained(device):
                if command is StateCommand.HOME:
                    moves = "hold" in device.crtk_commands  # a sensor does not
                    with held_when_interrupted(device) if moves else nullcontext():
                        home_to_its_end(device)
                else:
                    device.state_command(command.value)
            OUT.print(
                f"{plain(device.namespace)}  ", status_words(device.operating_state()), sep=""
            )

    return run


def _hold(namespace: Namespace, timeout: Timeout = FIND_TIMEOUT, child: Child = "") -> None:
    from crtk_drivers.cli.hold_command import hold

    with reached(namespace, timeout, child) as device:
        raise typer.Exit(hold(device))


def _free(namespace: Namespace, timeout: Timeout = FIND_TIMEOUT, child: Child = "") -> None:
    with reached(namespace, timeout, child) as device:
        need(device, "free")
        device.free()
        OUT.print(f"{plain(device.namespace)}  free sent, and not refused")


for _each in StateCommand:
    app.command(_each.value, cls=HelpfulCommand, help=_help(_each.value))(_state_command(_each))
for _name, _command in (("hold", _hold), ("free", _free)):
    app.command(_name, cls=HelpfulCommand, help=_help(_name))(_command)


@app.command("move", cls=HelpfulCommand, context_settings=_NUMBERS)
def _move(
    namespace: Namespace,
    values: Annotated[
        list[str],
        typer.Argument(
            metavar="VALUES...",
            help="One number for each joint, in rad or m; or joint=number for some; or, with "
            "--pose, x y z in m and a quaternion x y z w if the tool shall turn.",
            show_default=False,
            callback=_no_options,
        ),
    ],
    pose: Annotated[
        bool, typer.Option("--pose", help="The tool goes to a pose in the base frame.")
    ] = False,
    relative: Annotated[
        bool, typer.Option("--relative", help="The values are added to where it is.")
    ] = False,
    degrees: Annotated[bool, typer.Option("--degrees", help="Joint values are degrees.")] = False,
    speed: Annotated[
        float | None,
        typer.Option(
            "--speed",
            metavar="SHARE",
            help="Share of the device's speed and acceleration for this move: 0.1 is a tenth.",
            show_default=False,
        ),
    ] = None,
    child: Child = "",
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Move an ENABLED device, show the progress, and say where it is then. Ctrl-C holds it.

    Examples:

        crtk-driver move /ur5 0.3 -1.3 1.4 -1.6 -1.57 0
        crtk-driver move /ur5 --degrees wrist_3_joint=90
        crtk-driver move /ur5 --speed 0.1 --pose --relative 0 0 0.05
    """
    from crtk_drivers.cli.move_command import move

    with reached(namespace, timeout, child) as device:
        code = move(device, values, pose=pose, relative=relative, degrees=degrees, speed=speed)
        raise typer.Exit(code)


@app.command("echo", cls=HelpfulCommand)
def _echo(
    namespace: Namespace,
    topic: Annotated[
        str,
        typer.Argument(
            metavar="TOPIC",
            help="measured_js, operating_state, refusals, state/..., or a full name.",
            show_default=False,
        ),
    ],
    once: Annotated[bool, typer.Option("--once", help="End after the first value.")] = False,
    rate: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", min=0.001, help="Print at most so many in a second."),
    ] = None,
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Print what a device tells on a topic, as YAML; after Ctrl-C, how many values came in a second.

    Examples:

        crtk-driver echo /ur5 measured_js --once
        crtk-driver echo /ur5 measured_cp --rate 2
        crtk-driver echo /ur5 refusals
    """
    from crtk_drivers.cli.echo_command import echo

    with reached(namespace, timeout) as device:
        raise typer.Exit(echo(device, topic, once, rate, timeout))


@app.command("call", cls=HelpfulCommand, context_settings=_NUMBERS)
def _call(
    namespace: Namespace,
    service: Annotated[
        str,
        typer.Argument(
            metavar="SERVICE",
            help="forward_kinematics, or what the page of the device names.",
            show_default=False,
        ),
    ],
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="ARGUMENTS...",
            help="Fields of the request: field=value. Of forward_kinematics the joints; of "
            "inverse_kinematics x y z and a quaternion x y z w, then joints to start from.",
            show_default=False,
            callback=_no_options,
        ),
    ] = None,
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Call a service of a device, print its answer as YAML, and end with 1 if that is a refusal.

    Examples:

        crtk-driver call /ft bias
        crtk-driver call /ur5 forward_kinematics 0.3 -1.3 1.4 -1.6 -1.57 0
    """
    from crtk_drivers.cli.echo_command import call

    with reached(namespace, timeout) as device:
        raise typer.Exit(call(device, service, arguments or [], timeout))
