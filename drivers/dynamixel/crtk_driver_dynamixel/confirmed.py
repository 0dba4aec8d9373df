"""Registers that are written until they are read back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from crtk_driver_dynamixel.chain_link import ChainLink
from crtk_driver_dynamixel.preparation import ATTEMPTS
from crtk_driver_dynamixel.servo_state import Values
from crtk_drivers.device import Steps
from crtk_drivers.errors import DeviceFault


def make_sure(link: ChainLink, wanted: Mapping[int, Values], *, written: bool = False) -> Steps:
    """Write registers, by the place of their servo, until they hold these values.

    Args:
        written: they were, just before.

    Raises:
        DeviceFault: they never do.
    """
    wanted = {
        place: known
        for place, values in wanted.items()
        if (known := {n: v for n, v in values.items() if link.states[place].has(n)})
    }
    differing: dict[int, list[str]] = {}
    for attempt in range(ATTEMPTS):
        if attempt or not written:
            link.write_values(wanted)
            yield
        differing = wrong(link, wanted)
        if not differing:
            return
        wanted = {place: wanted[place] for place in differing}
    raise stubborn(link, differing)


def wrong(link: ChainLink, wanted: Mapping[int, Values]) -> dict[int, list[str]]:
    """Return which registers of which servos do not hold what they should; those that do are kept."""
    names = sorted({name for values in wanted.values() for name in values})
    found = link.read_values(wanted, names) if names else {}
    differing: dict[int, list[str]] = {}
    for place, values in wanted.items():
        read = found.get(place, {})
        names = [name for name, value in values.items() if read.get(name) != value]
        if names:
            differing[place] = names
        link.learn(place, read)
    return differing


def stubborn(link: ChainLink, differing: Mapping[int, Iterable[str]]) -> DeviceFault:
    """Return the fault of servos whose registers do not take what is written."""
    told = "; ".join(
        f"{link.chain.servos[place].place}: {', '.join(names)}"
        for place, names in differing.items()
    )
    return DeviceFault(
        f"registers do not take what is written: {told}",
        where=link.address,
        remedy="Does it answer reliably, and is its supply right? See the counters in diagnostics.",
    )
