"""Deterministic simulation: a driver and its simulator on one simulated machine, with virtual time.

machine/   the simulated machine: scheduler, clocks, locks, files, sockets, terminals, processes
middleware/    ROS 2 between its processes
hosts/     the processes that worlds run in, and pytest in them
promises/  users who do all that a device offers, and judges of what was promised
troubles.py    bad weather and faults

run        run a scenario with a seed
World      what a scenario is given
Outcome    what came of it: findings, and the story that led to them
search     many seeds, several at a time
shrink     the fewest troubles that a finding needs
Subject    a device whose truth is known, for the judges of all devices
user       scenarios for a subject: what users do
Instrument a device that measures, whose truth is known; ForceSensor: one that measures forces
Haptic     a haptic device whose force is known
instrument_user, pusher    scenarios for these
far_user   a scenario for a subject on the far side of ROS 2
is_here    whether this process runs worlds: for a conftest.py

Tests marked ``@pytest.mark.world`` run in worlds as they are: `pytest_worlds`.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crtk_drivers.testing.world.hosts.host_process import WorldError
    from crtk_drivers.testing.world.hosts.runner import Host, run, search, shrink
    from crtk_drivers.testing.world.machine.kernel import NotSimulated
    from crtk_drivers.testing.world.promises import far_user, instrument_user, pusher, user
    from crtk_drivers.testing.world.promises.instrument import ForceSensor, Instrument
    from crtk_drivers.testing.world.promises.pusher import Haptic
    from crtk_drivers.testing.world.promises.subject import Subject
    from crtk_drivers.testing.world.world import World
    from crtk_drivers.testing.world.world_outcome import Finding, Outcome

__all__ = [
    "Finding",
    "ForceSensor",
    "Haptic",
    "Host",
    "Instrument",
    "NotSimulated",
    "Outcome",
    "Subject",
    "World",
    "WorldError",
    "far_user",
    "instrument_user",
    "is_here",
    "pusher",
    "run",
    "search",
    "shrink",
    "user",
]

# Imported when first used: a host patches the standard library before anything that keeps its functions.
_PLACES = {
    "Finding": "world_outcome",
    "ForceSensor": "promises.instrument",
    "Haptic": "promises.pusher",
    "Host": "hosts.runner",
    "Instrument": "promises.instrument",
    "NotSimulated": "machine.kernel",
    "Outcome": "world_outcome",
    "Subject": "promises.subject",
    "World": "world",
    "WorldError": "hosts.host_process",
    "far_user": "promises",
    "instrument_user": "promises",
    "pusher": "promises",
    "run": "hosts.runner",
    "search": "hosts.runner",
    "shrink": "hosts.runner",
    "user": "promises",
}


def is_here() -> bool:
    """Return whether this process runs worlds: it is one, or forks them."""
    kernel = sys.modules.get(f"{__name__}.machine.kernel")
    return kernel is not None and kernel.running.patched


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    place = f"{__name__}.{_PLACES[name]}"
    if place.endswith(".promises"):
        return import_module(f"{place}.{name}")
    return getattr(import_module(place), name)
