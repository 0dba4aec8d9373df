"""The commands of ``crtk-driver`` beside the devices, as its help lists them while no module is imported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import Any, Final

import typer
from typing_extensions import override

from crtk_drivers.cli.help_pages import HelpfulGroup, Listed


@dataclass(frozen=True)
class OwnCommand:
    """One of them.

    Attributes:
        summary: the first paragraph of its help.
        panel: under which it is listed.
        module: of this package; it is a command of the `app` there.
    """

    summary: str
    panel: str
    module: str


_TOOLS: Final = "Tools"
_CLIENT: Final = "Use a device that runs, of any maker"

OWN_COMMANDS: Final[Mapping[str, OwnCommand]] = MappingProxyType(
    {
        name: OwnCommand(summary, panel, module)
        for name, panel, module, summary in (
            ("list", _TOOLS, "list_command",
             "List the devices and simulators, and whether they can be used."),
            ("schema", _TOOLS, "schema_command",
             "Print the JSON schema of a device's configuration."),
            ("new", _TOOLS, "new_command",
             "Write a plugin for a device of your own: driver, simulator and tests to start from, "
             "which pass."),
            ("up", _TOOLS, "up_command",
             "Bring up all devices of a lab, one process each, until Ctrl-C."),
            ("state", _CLIENT, "client_commands",
             "Show how a device is, why, and where it stands; without NAMESPACE, which devices "
             "there are."),
            ("view", _CLIENT, "view_command",
             "Show devices of any maker while they run: arms in 3-D, values over time, states, "
             "health, refusals."),
            ("enable", _CLIENT, "client_commands",
             "Power a device up, so that it accepts motion commands."),
            ("disable", _CLIENT, "client_commands", "Power a device down."),
            ("home", _CLIENT, "client_commands",
             "Find the reference positions. It may move; Ctrl-C holds it."),
            ("unhome", _CLIENT, "client_commands", "Forget the reference positions."),
            ("pause", _CLIENT, "client_commands", "Stop a device, with its power on."),
            ("resume", _CLIENT, "client_commands", "Go on after a pause."),
            ("hold", _CLIENT, "client_commands", "Stop a device, in any state, and stay there."),
            ("free", _CLIENT, "client_commands",
             "Let a device go, so that it can be moved by hand."),
            ("move", _CLIENT, "client_commands",
             "Move an ENABLED device, show the progress, and say where it is then. Ctrl-C holds it."),
            ("echo", _CLIENT, "client_commands",
             "Print what a device tells on a topic, as YAML; after Ctrl-C, how many values came in "
             "a second."),
            ("call", _CLIENT, "client_commands",
             "Call a service of a device, print its answer as YAML, and end with 1 if that is a "
             "refusal."),
            ("record", _CLIENT, "record_command",
             "Record what devices of any maker tell and are told on ROS 2, until Ctrl-C."),
            ("replay", _CLIENT, "replay_command",
             "Publish what a device told once more, or let an arm go the way of its joints again."),
            ("bench", _TOOLS, "bench_command",
             "Test the devices of a lab, and keep verdicts, figures and recordings."),
            ("conform", _CLIENT, "conform_command",
             "Judge a device, of any maker, by the clauses of CRTK. Without --may-move it only "
             "listens and asks."),
            ("plot", _TOOLS, "tape_commands",
             "Draw a recording: a page (HTML, one file, no script) and a picture (PNG, by the extra "
             "`plot`)."),
            ("convert", _TOOLS, "tape_commands",
             "Write a recording as tables, a file a topic: times and stamps in ns, and what the "
             "message says."),
            ("calibrate", _CLIENT, "calibrate_command",
             "Find where the tip of a pointer, a model, a tracker or its marker is, from what devices "
             "measure."),
            ("igtl", _CLIENT, "igtl_command",
             "Let 3D Slicer, or another program that speaks OpenIGTLink, see and command devices, "
             "until Ctrl-C."),
            ("teleop", _CLIENT, "teleop_command",
             "Let one device lead another one, by pedals, as `teleop` in a lab file says, "
             "until Ctrl-C."),
            ("check", _TOOLS, "check_command",
             "Check that a device, or its simulator, is ready to run."),
            ("lab", _TOOLS, "up_command", "Write a lab file to start from, or check one."),
            ("policy", _TOOLS, "policy_command",
             "Print who may command a device, and who may listen, as an SROS2 policy."),
            ("moveit", _TOOLS, "moveit_command",
             "Print the file that tells MoveIt of a device's actions: of "
             "moveit_simple_controller_manager."),
            ("sim", _TOOLS, "sim_command", "Run a simulator alone, for any client."),
        )
    }
)  # fmt: skip


class OwnGroup(HelpfulGroup):
    """They as a group: each is made, and its module imported, when it is used."""

    @override
    def list_commands(self, ctx: Any) -> list[str]:
        """Return their names."""
        return list(OWN_COMMANDS)

    @override
    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return one of them."""
        if cmd_name not in OWN_COMMANDS:
            return None
        if cmd_name not in self.commands:
            module = import_module(f"crtk_drivers.cli.{OWN_COMMANDS[cmd_name].module}")
            self.commands.update(typer.main.get_group(module.app).commands)
        return self.commands[cmd_name]

    @override
    def listed(self, ctx: Any, name: str) -> Listed | None:
        """Return how one of them is listed, which imports nothing."""
        return Listed(OWN_COMMANDS[name].summary, OWN_COMMANDS[name].panel)
