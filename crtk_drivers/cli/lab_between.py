"""What ``crtk-driver lab check`` finds between the machines of a lab, and what to do about it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from rich.table import Table
from rich.text import Text

from crtk_drivers.cli.status_line import STATE_STYLES
from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.client.lab_findings import View, clock_words, findings
from crtk_drivers.client.lab_look import Looked, look
from crtk_drivers.client.other_domains import Announced, announced
from crtk_drivers.config.variables import DOMAIN
from crtk_drivers.errors.wording import worded
from crtk_drivers.labs import Lab
from crtk_drivers.ros.manifest import CRTK_VERSION, driver_version
from crtk_drivers.state import OperatingState

__all__ = ["check_between"]

MOST_DOMAINS: Final = 4
"""Others that are looked into: each takes a participant of DDS for some seconds."""


def check_between(lab: Lab) -> int:
    """Look on ROS, in this process's domain, for the devices of a lab; print how they are and what is wrong.

    Returns:
        1 if something is wrong between its machines, else 0. A machine that is not up yet is not wrong.
    """
    view = _view(lab)
    OUT.print()
    OUT.print(_table(lab, view))
    is_wrong = False
    for finding in findings(lab, view):
        is_wrong = is_wrong or finding.is_wrong
        label = ("wrong: ", "bold red") if finding.is_wrong else ("note: ", "bold yellow")
        OUT.print(Text.assemble("\n", label, worded(finding.text)), soft_wrap=True)
        OUT.print(Text.assemble(("  hint: ", "bold green"), worded(finding.remedy)), soft_wrap=True)
    return 1 if is_wrong else 0


def _view(lab: Lab) -> View:
    """Look in the domain of the lab; where something is missing there, in those where others are."""
    spaces = {name: device.namespace for name, device in lab.everywhere.items()}
    domain = int(os.environ.get(DOMAIN) or 0)
    machines = ", ".join(name for name in lab.machines if name != lab.machine)
    with ERR.status(f"looking on ROS for devices of {plain(machines)} ...") as status:
        looked = look(spaces)
        missing = {name: spaces[name] for name in lab.elsewhere if not looked[name].seen.seen}
        found: dict[int, dict[str, Looked]] = {}
        heard: tuple[Announced, ...] = ()
        if missing:
            status.update("listening for other domains ...")
            heard = announced()
            others = list(dict.fromkeys(each.domain for each in heard if each.domain != domain))
            if others:
                status.update(f"looking into domain {', '.join(map(str, others))} ...")
            found = _elsewhere(missing, others[:MOST_DOMAINS])
    return View(looked, domain, driver_version(), CRTK_VERSION, found, heard)


def _elsewhere(missing: Mapping[str, str], domains: list[int]) -> dict[int, dict[str, Looked]]:
    """Return which of some devices are seen in other domains."""
    with ThreadPoolExecutor(MOST_DOMAINS) as pool:
        looked = list(pool.map(lambda domain: look(missing, domain), domains))
    return {
        domain: {name: each for name, each in found.items() if each.seen.seen}
        for domain, found in zip(domains, looked, strict=True)
    }


def _table(lab: Lab, view: View) -> Table:
    table = Table(title="seen on ROS", title_justify="left", box=None, pad_edge=False)
    for column in ("device", "machine", "runs on", "state", "version", "clock"):
        table.add_column(column, no_wrap=True)
    devices = lab.everywhere
    for name, looked in view.looked.items():
        seen = looked.seen
        state = Text("not seen", "yellow")
        if seen.seen:
            style = STATE_STYLES[OperatingState(seen.state)] if seen.state else ""
            state = Text(seen.state or "no state", style)
        said = Text(seen.host), state, Text(looked.driver_version), Text(clock_words(looked))
        table.add_row(Text(name, "bold cyan"), devices[name].machine, *said)
    return table
