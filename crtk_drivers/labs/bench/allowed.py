"""What a run of the bench may do to a device, and why it may not do more."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Suite
from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.lab_file import LabDevice
from crtk_drivers.plugins import SimFault

FASTEST_TRAVEL: Final = 0.5
"""Share of its speed at which a real device may go through its space."""

FAULTS: Final = "CRTK_BENCH_FAULTS"
"""Environment variable: 1 where whoever starts the bench wants what the lab file allows by `faults`."""


GUARDS: Final = ("M1", "S8", "S1")
"""Tests that a real device passes before it goes through its space, or a fault is caused."""

FEATURES: Final = {
    "block": "the width in m of a block that lies between its fingers",
    "grip": "the force in N with which a gripper is to grip, as it is configured",
    "bar": "the way in m between two of its tools, which are fixed to each other",
}
"""What stands beside a device for some tests, by the name in the lab file."""

BESIDE_A_FAULT: Final = {Safety.FAULT: Safety.ENABLE, Safety.FAULT_IN_MOTION: Safety.SMALL}
"""What an acquisition does beside the fault that it is about."""


@dataclass(frozen=True)
class BenchOptions:
    """What a run is asked to do.

    Attributes:
        suite: which tests.
        only: ids of tests, instead of those of the suite.
        may_move: whoever started it stands beside it, and wants motion.
        out: folder of the run; it may not exist.
        may_travel: names of the devices that may go anywhere in their space.
        at_once: simulated devices that are tested at the same time.
    """

    suite: Suite
    only: tuple[str, ...]
    may_move: bool
    out: Path
    may_travel: tuple[str, ...] = ()
    at_once: int = 1


@dataclass(frozen=True)
class Carrier:
    """A device that carries another one, which is tested by moving it.

    Attributes:
        lab: as the lab file has it.
        about: as it was found; None if it was not reached.
        stopped: why it is not used any more in this run, empty if it is.
    """

    lab: LabDevice
    about: About | None
    stopped: str


def lacking(
    test: BenchTest,
    about: About,
    device: LabDevice,
    options: BenchOptions,
    *,
    carrier: Carrier | None = None,
    faults: bool = False,
    features: Mapping[str, bool | float | str] = MappingProxyType({}),
) -> str:
    """Return why a test is skipped, in words; empty if it is not.

    Args:
        test: of the bench.
        about: the device as it was found.
        device: as the lab file has it.
        options: of the run.
        carrier: the device that carries it, if that is in the run.
        faults: the lab file allows faults of hardware.
        features: what else stands in the lab, as the lab file says.
    """
    acquisition = test.acquisition
    offered = (*about.commands, *about.services)
    missing = [name for name in (*acquisition.needs, *test.needs) if name not in offered]
    if missing:
        return f"the device does not offer {', '.join(missing)}"
    if test.group == "sampling" and not about.capabilities.measured:
        return "the device measures nothing itself"
    if acquisition.loads and device.sim and device.plugin.sim_load is None:
        return "its simulator feels no load"
    if why := _not_set_up(test, device, features):
        return why
    if acquisition.homes and (why := _not_homed(about, device, features)):
        return why
    if acquisition.relayed:
        beside = BESIDE_A_FAULT[acquisition.safety]
        return _not_cut(device, faults) or not_allowed(beside, about, device, options)
    if acquisition.by_operator:
        beside = BESIDE_A_FAULT[acquisition.safety]
        return _not_operated(device, features) or not_allowed(beside, about, device, options)
    if acquisition.carrier_needs:
        return (
            _not_faulted(acquisition, device)
            or _not_marked(acquisition, device, carrier)
            or _not_gripped(acquisition, device, carrier)
            or _not_carried(acquisition, carrier, options)
        )
    return not_allowed(acquisition.safety, about, device, options)


def unguarded(test: BenchTest, moved: LabDevice, ids: Collection[str]) -> str:
    """Return which tests a real device lacks that come before it goes far; empty if it has them.

    An emergency stop at rest comes before all of them, if whoever stands there wants it.

    Args:
        test: that is to be carried out.
        moved: the device that it moves.
        ids: of all tests of the run.
    """
    missing = [guard for guard in GUARDS if guard not in ids]
    is_near = test.acquisition.safety < Safety.LARGE or test.acquisition.by_operator
    if is_near or moved.simulated or not missing:
        return ""
    return f"needs {', '.join(missing)} in the same run: what must pass before it goes that far"


def _not_faulted(acquisition: Acquisition, device: LabDevice) -> str:
    is_fault = acquisition.safety >= Safety.FAULT
    return "is done to simulators only" if is_fault and not device.sim else ""


def _not_marked(acquisition: Acquisition, device: LabDevice, carrier: Carrier | None) -> str:
    """Return why no marker of a tracker is moved, in words; empty if one is."""
    if not acquisition.is_marked:
        return ""
    if carrier is None or not device.entry.markers_on(carrier.lab.name):
        return "needs a device that carries one of its tools (`markers`) in the same run"
    if (device.simulated or carrier.lab.simulated) and device.coupled is None:
        return (
            "its simulator does not see the marker on the arm: both are to be simulated, and the lab file "
            "says where it `stands`"
        )
    return ""


def _not_gripped(acquisition: Acquisition, device: LabDevice, carrier: Carrier | None) -> str:
    """Return why nothing happens to a simulated device that carries another one; empty if it does."""
    fault = acquisition.carrier_fault
    if fault is None or carrier is None:
        return ""
    if device.simulated is not carrier.lab.simulated:
        return f"{carrier.lab.name} and it are to be simulated both, or neither"
    if carrier.lab.sim and fault not in carrier.lab.plugin.sim_faults:
        return f"the simulator of {carrier.lab.name} cannot do that {fault}"
    return ""


def _not_homed(about: About, device: LabDevice, features: Mapping[str, bool | float | str]) -> str:
    """Return why a device is not let home again, in words; empty if it is."""
    if not about.capabilities.needs_homing:
        return "its positions count without homing"
    if device.simulated or features.get("homing") is True:
        return ""
    return (
        "needs `features = { homing = true }` in the lab file: it homes, wherever it goes for that"
    )


def _not_carried(acquisition: Acquisition, carrier: Carrier | None, options: BenchOptions) -> str:
    """Return why a device is not carried about, in words; empty if it is."""
    if carrier is None:
        return "needs a device that carries it (`on`) in the same run"
    why = _not_moved(acquisition, carrier, options)
    return why and f"{carrier.lab.name}, which carries it: {why}"


def _not_moved(acquisition: Acquisition, carrier: Carrier, options: BenchOptions) -> str:
    about = carrier.about
    if about is None:
        return "was not reached"
    if carrier.stopped:
        return carrier.stopped
    missing = [name for name in acquisition.carrier_needs if name not in about.commands]
    if missing:
        return f"does not offer {', '.join(missing)}"
    safety = BESIDE_A_FAULT.get(acquisition.safety, acquisition.safety)
    return not_allowed(safety, about, carrier.lab, options)


def _not_cut(device: LabDevice, faults: bool) -> str:
    """Return why the link to a device is not cut, in words; empty if it may be."""
    link = device.plugin.link
    if link is None or (not device.sim and link.of(device.config, None) is None):
        return "its driver reaches it over nothing that a relay could cut"
    if device.sim:
        return ""
    if not faults:
        return "needs `faults = true` in the lab file: it cuts the link to hardware"
    if os.environ.get(FAULTS) != "1":
        return f"needs {FAULTS}=1 in the environment: it cuts the link to hardware"
    return ""


def _not_set_up(
    test: BenchTest, device: LabDevice, features: Mapping[str, bool | float | str]
) -> str:
    """Return what stands there, or does not, so that a test is not carried out; empty if all is well."""
    acquisition = test.acquisition
    for name in (*acquisition.features, *test.features):
        given = features.get(name)
        if isinstance(given, bool) or not isinstance(given, int | float) or not given > 0.0:
            return f"needs `features = {{ {name} = ... }}` in the lab file: {FEATURES[name]}"
    there = [name for name in acquisition.without if name in features]
    if there and not device.simulated:
        return f"the lab file has the feature {there[0]}: {FEATURES[there[0]]}"
    fault = acquisition.sim_fault
    if fault is not None and device.sim and fault not in device.plugin.sim_faults:
        return f"its simulator cannot do that {fault}"
    return ""


def _not_operated(device: LabDevice, features: Mapping[str, bool | float | str]) -> str:
    """Return why nobody presses the emergency stop of a device, in words; empty if somebody does."""
    if device.plugin.is_model or (
        device.sim and SimFault.EMERGENCY_STOP not in device.plugin.sim_faults
    ):
        return f"{'it' if device.plugin.is_model else 'its simulator'} has no emergency stop"
    if device.sim or features.get("operator") is True:
        return ""
    return "needs `features = { operator = true }` in the lab file: somebody presses its emergency stop"


def not_allowed(safety: Safety, about: About, device: LabDevice, options: BenchOptions) -> str:
    """Return why something may not be done to a device, in words; empty if it may."""
    if safety >= Safety.FAULT and not device.sim:
        return "is done to simulators only"
    if safety is Safety.READ or device.simulated:
        return ""
    if not options.may_move:
        return "needs --may-move: it enables the device"
    wrong = [
        f"{name} is {about.readings.get(name, 'not told')}, not {value}"
        for name, value in device.entry.identity.items()
        if about.readings.get(name) != value
    ]
    if wrong:
        return f"it is another device than the lab file says: {'; '.join(wrong)}"
    if about.capabilities.needs_homing and not about.is_homed:
        return "needs to be homed, which the bench does not do to hardware"
    space = device.entry.space
    if safety >= Safety.SMALL and space is None:
        return "needs `space` in the lab file: where it may go"
    if space is not None and space.tool_box and "measured_cp" not in about.commands:
        return "its space has a `tool_box`, and it does not tell where its tool is"
    return _not_to_travel(device, options) if safety >= Safety.LARGE else ""


def _not_to_travel(device: LabDevice, options: BenchOptions) -> str:
    """Return why a device may not go through all of its space, in words; empty if it may."""
    space = device.entry.space
    if space is None or not space.joints:
        return "needs `space.joints` in the lab file: it goes to the ends of these ranges"
    if space.speed > FASTEST_TRAVEL:
        return (
            f"its space has a `speed` of {space.speed:g}: it goes to the ends of its space, "
            f"at {FASTEST_TRAVEL:g} at most"
        )
    if device.name not in options.may_travel:
        return f"needs --may-travel {device.name}: it goes through all of its space"
    return ""
