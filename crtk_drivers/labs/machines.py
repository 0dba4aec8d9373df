"""The machines of a lab: who starts which device and program.

Each machine starts its share of one lab file with `crtk-driver up`; ROS carries what they have to say to one
another. A machine is named as it calls itself (its host name).
"""

from __future__ import annotations

import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from crtk_drivers.config import Layer
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.lab_entries import ALL_MACHINES, LabSettings

__all__ = ["Elsewhere", "NoMachineOfLab", "Shares", "is_called", "named_machine", "shares_of"]

Owner = tuple[str, str]
"""``devices`` or ``programs``, and a name."""


@dataclass(frozen=True)
class Elsewhere:
    """A device of the lab that another machine starts. Its settings are checked there.

    Attributes:
        name: in the lab.
        plugin: name of its driver, which need not be installed here.
        namespace: on ROS.
        machine: which starts it.
    """

    name: str
    plugin: str
    namespace: str
    machine: str


@dataclass(frozen=True)
class Shares:
    """Which machine starts what.

    Attributes:
        machines: the names, in the order of the file; none where the lab file names no machine.
        owners: the machine of each device and program.
    """

    machines: tuple[str, ...]
    owners: Mapping[Owner, str]

    def is_of(self, owner: Owner, machine: str) -> bool:
        """Whether a machine starts a device or program; empty or `ALL_MACHINES`: every machine does."""
        return machine in ("", ALL_MACHINES) or self.owners.get(owner, machine) == machine


class NoMachineOfLab(ConfigError):
    """The lab file does not say which machine this is, by its host name."""


def shares_of(settings: LabSettings, lab: Layer) -> Shares:
    """Return which machine starts each device and program of a lab.

    Raises:
        ConfigError: some are of a machine and others of none, or two names can be one machine.
    """
    said: dict[Owner, str] = {
        ("devices", name): entry.machine or settings.machine
        for name, entry in settings.devices.items()
    }
    said |= {
        ("programs", name): entry.machine or settings.machine
        for name, entry in settings.programs.items()
    }
    machines = tuple(dict.fromkeys(filter(None, said.values())))
    if not machines:
        return Shares((), {})
    for owner, machine in said.items():
        if not machine:
            raise ConfigError(
                f"nobody says which machine starts {owner[1]}, and others have one "
                f"({', '.join(machines)})",
                where=lab.place(owner),
                remedy=f'Give it one, machine = "{machines[0]}"; or write that line above all tables, for '
                "whatever names none.",
            )
    for at, machine in enumerate(machines):
        for other in machines[:at]:
            if is_called(machine, other) or is_called(other, machine):
                owner = next(owner for owner, each in said.items() if each == machine)
                raise ConfigError(
                    f"{machine} and {other} are one machine by their names",
                    where=lab.place((*owner, "machine")),
                    remedy="Write it the same way everywhere.",
                )
    return Shares(machines, said)


def named_machine(shares: Shares, given: str = "") -> str:
    """Return which machine of a lab this is; empty where the lab file names none.

    Args:
        shares: of the lab file.
        given: a name that was typed, or `ALL_MACHINES`; empty: go by the host name.

    Raises:
        NoMachineOfLab: this machine is not in the lab file, or it can be two of them.
        ConfigError: the one that was typed is not.
    """
    is_all = given.casefold() == ALL_MACHINES
    if not shares.machines:
        if is_all or not given:
            return ""
        raise ConfigError(
            f"{given}: the lab file names no machine",
            where="--machine",
            remedy='Leave --machine out, or give its devices one: machine = "..."',
        )
    if is_all:
        return ALL_MACHINES
    host = given or socket.gethostname()
    found = _called(host, shares.machines)
    if len(found) == 1:
        return found[0]
    names = ", ".join(shares.machines)
    if found:
        raise NoMachineOfLab(
            f"{host!r} can be {' or '.join(found)} of the lab file",
            remedy=f"Say which of them this one is, --machine {found[0]}.",
        )
    if given:
        raise ConfigError(
            f"there is no machine {given!r} in the lab file",
            where="--machine",
            remedy=f"There is: {names}; or {ALL_MACHINES}, for the whole lab on this one.",
        )
    raise NoMachineOfLab(
        f"this machine is called {host!r}, and the lab file names {names}",
        remedy=f"Say which of them this one is, --machine {shares.machines[0]}; or --machine {ALL_MACHINES}, "
        "for the whole lab on this one.",
    )


def _called(host: str, names: Sequence[str]) -> list[str]:
    """Return which machines a host name can mean: the same name, else one longer or shorter."""
    same = [name for name in names if name.casefold() == host.casefold()]
    return same or [name for name in names if is_called(host, name) or is_called(name, host)]


def is_called(host: str, name: str) -> bool:
    """Whether a host name is that of a machine: ``Control.lab.example`` is ``control``."""
    host, name = host.casefold(), name.casefold()
    return host == name or host.split(".", 1)[0] == name
