"""What is wrong between the machines of a lab, judged by what was seen of their devices on ROS."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from crtk_drivers.client.lab_look import Looked
from crtk_drivers.client.other_domains import Announced
from crtk_drivers.config.variables import DOMAIN
from crtk_drivers.labs.lab_file import Lab
from crtk_drivers.labs.machines import is_called
from crtk_drivers.samples import CLOCKS_AGREE

__all__ = ["Finding", "View", "clock_words", "findings"]

UNKNOWN: Final = "unknown"
"""A version that `crtk_drivers.ros.manifest` does not know."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was found.

    Attributes:
        text: what it is.
        remedy: what to do.
        is_wrong: nobody wants it so. Otherwise it may be meant, such as a machine that is not up yet.
    """

    text: str
    remedy: str
    is_wrong: bool = True


@dataclass(frozen=True)
class View:
    """What was seen of a lab from one of its machines.

    Attributes:
        looked: each device of the lab, by name.
        domain: in which it was looked.
        driver_version, crtk_version: of this machine.
        other_domains: devices that were not seen there and are in another domain, by domain and name.
        announced: ROS 2 of other machines; looked for where a device was not seen.
    """

    looked: Mapping[str, Looked]
    domain: int
    driver_version: str
    crtk_version: str
    other_domains: Mapping[int, Mapping[str, Looked]] = field(default_factory=dict)
    announced: tuple[Announced, ...] = ()


def findings(lab: Lab, view: View) -> Iterator[Finding]:
    """Yield all that is wrong between the machines of a lab, then what may be meant."""
    devices = lab.everywhere
    machines = {name: device.machine for name, device in devices.items()}
    for name, looked in view.looked.items():
        if looked.seen.seen:
            yield from _wrong_places(name, devices[name].namespace, machines[name], looked, lab)
    yield from _wrong_versions(view)
    yield from _wrong_clocks(lab, view, machines)
    yield from _strange_hosts(lab, view, machines)
    missing = [name for name in lab.elsewhere if not view.looked[name].seen.seen]
    for domain, found in view.other_domains.items():
        for name in [name for name in missing if name in found]:
            missing.remove(name)
            yield _in_other_domain(lab, name, domain, found[name], view.domain)
    for machine in dict.fromkeys(machines[name] for name in missing):
        names = [name for name in missing if machines[name] == machine]
        yield _not_seen(machine, names, view)


def clock_words(looked: Looked) -> str:
    """Return how far a clock is off as people read it: ``+0.1 ms (± 0.2 ms)``; empty if that is not known."""
    offset, uncertainty = looked.seen.offset, looked.seen.uncertainty
    if offset is None or uncertainty is None:
        return ""
    number, unit = (offset * 1e3, "ms") if abs(offset) < 1.0 else (offset, "s")
    rounded = round(number, 1) + 0.0  # no -0.0
    return f"{rounded:+.1f} {unit} (± {uncertainty * 1e3:.1f} ms)"


def _wrong_places(
    name: str, space: str, machine: str, looked: Looked, lab: Lab
) -> Iterator[Finding]:
    drivers, host = looked.drivers, looked.seen.host
    if len(drivers) > 1:
        yield Finding(
            f"{name}: {len(drivers)} drivers are in {space}, and the first one serves: "
            + "; ".join(driver.name for driver in drivers),
            f"End those that are not of {machine}.",
        )
        return
    owners = [each for each in lab.machines if _may_be(host, each, lab)]
    if owners and machine not in owners:
        yield Finding(
            f"{name} runs on {host}, and the lab file gives it to {machine}",
            f'End it there, or write machine = "{owners[0]}" at it.',
        )


def _strange_hosts(lab: Lab, view: View, machines: Mapping[str, str]) -> Iterator[Finding]:
    """Yield each host that is no machine of the lab by its name: `--machine` may have been typed there."""
    found: dict[tuple[str, str], list[str]] = {}
    for name, looked in view.looked.items():
        host = looked.seen.host
        if not any(_may_be(host, each, lab) for each in lab.machines):
            found.setdefault((host, machines[name]), []).append(name)
    for (host, machine), names in found.items():
        yield Finding(
            f"{host}, which the lab file does not name, runs {', '.join(names)} of {machine}",
            f"That is in order if {host} was started with --machine {machine}. Otherwise end it there, or "
            f'write machine = "{host}".',
            is_wrong=False,
        )


def _may_be(host: str, machine: str, lab: Lab) -> bool:
    """Whether a host can be a machine of the lab; one that did not say its name can be any."""
    if host == socket.gethostname():  # which may be called otherwise: `--machine`
        return machine == lab.machine
    return not host or is_called(host, machine) or is_called(machine, host)


def _wrong_versions(view: View) -> Iterator[Finding]:
    for what, here, attribute in (
        ("crtk-drivers", view.driver_version, "driver_version"),
        ("CRTK messages", view.crtk_version, "crtk_version"),
    ):
        others: dict[tuple[str, str], list[str]] = {}
        for name, looked in view.looked.items():
            version = getattr(looked, attribute)
            if version not in ("", UNKNOWN, here) and here != UNKNOWN:
                others.setdefault((looked.seen.host, version), []).append(name)
        for (host, version), names in others.items():
            yield Finding(
                f"{', '.join(names)} on {host}: version {version} of {what}, and {here} is here",
                "Install one version on all machines of the lab, and start them again.",
            )


def _wrong_clocks(lab: Lab, view: View, machines: Mapping[str, str]) -> Iterator[Finding]:
    """Yield each machine whose clock is off, as its device with the least uncertainty says."""
    found: dict[str, Looked] = {}
    for name, looked in view.looked.items():
        host, doubt = looked.seen.host or machines[name], looked.seen.uncertainty
        if doubt is not None and not is_called(host, lab.machine):
            best = found.get(host)
            if best is None or doubt < (best.seen.uncertainty or 0.0):
                found[host] = looked
    for host, looked in found.items():
        if looked.seen.has_other_time:
            yield Finding(
                f"the clock of {host} is off by {clock_words(looked)}; stamps of two machines are not "
                f"compared past {CLOCKS_AGREE * 1e3:g} ms",
                "Let chrony or PTP (ptp4l, phc2sys) set both clocks by one source, then start the drivers on "
                f"{host} again.",
            )


def _in_other_domain(lab: Lab, name: str, domain: int, looked: Looked, here: int) -> Finding:
    where = looked.seen.host or "another machine"
    said = f"{DOMAIN} is {domain}" if domain else f"{DOMAIN} is not set, or 0"
    remedy = (
        f"Start it there from this lab file, which says {DOMAIN} = {here}."
        if DOMAIN in lab.environment
        else f"Write environment = {{ {DOMAIN} = {here} }} above the tables of the lab file, give it "
        "to all machines, and start it again."
    )
    return Finding(
        f"{name} is not in domain {here}, but in domain {domain} on {where}: there {said}", remedy
    )


def _not_seen(machine: str, names: Iterable[str], view: View) -> Finding:
    others = [each for each in view.announced if each.domain == view.domain]
    elsewhere = [each for each in view.announced if each.domain != view.domain]
    if others:
        heard = f"In this domain {_listed(others)} announces itself, so multicast arrives here."
    elif elsewhere:
        heard = f"In other domains: {', '.join(f'{each.domain}: {_listed([each])}' for each in elsewhere)}."
    else:
        heard = "Nothing of DDS on another machine is heard here, in any domain."
    return Finding(
        f"nothing of {machine} is seen in domain {view.domain}: {', '.join(names)}. {heard}",
        f"Is `crtk-driver up` running on {machine}? If it is, compare {DOMAIN}, "
        "ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_STATIC_PEERS and RMW_IMPLEMENTATION in both shells. Then look at "
        "the firewall (UDP from port 7400), and whether the switch or Wi-Fi lets multicast pass "
        "(239.255.0.1): ROS_STATIC_PEERS does without.",
        is_wrong=False,
    )


def _listed(announced: Iterable[Announced]) -> str:
    words = (
        f"{each.address} ({each.vendor})" if each.vendor else each.address for each in announced
    )
    return ", ".join(dict.fromkeys(words))
