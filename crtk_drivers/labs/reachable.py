"""Whether the machines of a lab can meet on ROS, as far as variables decide that.

Source: ROS 2 Jazzy, "Improved dynamic discovery": nobody is met with the range OFF, whatever the static peers
are; with LOCALHOST, static peers are. rmw_zenoh knows neither.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from crtk_drivers.config.variables import (
    DOMAIN,
    LOCALHOST_ONLY,
    RANGE,
    RANGES,
    RMW,
    STATIC_PEERS,
    as_said,
)
from crtk_drivers.labs.lab_entries import ALL_MACHINES
from crtk_drivers.labs.lab_file import Lab
from crtk_drivers.labs.unit_environment import JUDGED_BY_NOBODY

__all__ = ["doubts_between", "why_closed"]

_OF_A_NETWORK: Final = ("", "SUBNET", "SYSTEM_DEFAULT")
_WITHOUT_A_RANGE: Final = "rmw_zenoh"

REMEDY: Final = (
    f'Write environment = {{ {DOMAIN} = 42, {RANGE} = "SUBNET" }} above the tables of the lab file.'
)


def doubts_between(lab: Lab, variables: Mapping[str, str]) -> Iterator[str]:
    """Yield why the machines of a lab may not meet; nothing of a lab on one machine.

    Args:
        lab: the share of one of them.
        variables: with which its processes run.
    """
    if len(lab.machines) < 2 or lab.machine == ALL_MACHINES:
        return
    said = as_said(variables)
    if why := why_closed(said):
        remedy = REMEDY
        if said.get(LOCALHOST_ONLY) == "1":  # it goes over the range
            remedy = f"Write {LOCALHOST_ONLY} = 0 into `environment` of the lab file."
        elif DOMAIN in lab.settings.environment:
            remedy = f'Write {RANGE} = "SUBNET" into `environment` of the lab file.'
        yield f"the machines of this lab cannot see each other: {why}. {remedy}"
    if DOMAIN not in lab.settings.environment:
        here = said.get(DOMAIN) or "0"
        yield (
            f"the shell of each machine decides its domain ({DOMAIN}, here {here}), and only those of one "
            f"domain meet. {REMEDY}"
        )


def why_closed(variables: Mapping[str, str]) -> str:
    """Return why processes with these variables meet nobody on other machines; empty if they may."""
    said = as_said(variables)
    if said.get(RMW, "").startswith(_WITHOUT_A_RANGE):
        return ""
    if any(said.get(name) for name in JUDGED_BY_NOBODY):
        return ""
    if said.get(LOCALHOST_ONLY) == "1":
        return f"{LOCALHOST_ONLY} is 1"
    reached = said.get(RANGE, "")
    if reached in _OF_A_NETWORK:
        return ""
    if reached != "OFF" and said.get(STATIC_PEERS):
        return ""
    meant = reached if reached in RANGES else f"{reached}, which ROS 2 takes for LOCALHOST"
    return f"{RANGE} is {meant}"
