"""Faults of simulated drives: what there is, and how each begins and ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, TypeAlias

from crtk_sim_backends.canopen.axis import Axis
from crtk_sim_backends.canopen.drive import Drive
from crtk_sim_backends.faults import Fault, FaultError, FaultKind, Parameter

# Error codes of CiA 301, table 26, and CiA 402-2, table 6, by name.
ERRORS: Final[dict[str, int]] = {
    "generic": 0x1000,
    "over_current": 0x2310,
    "mains_over_voltage": 0x3110,
    "mains_under_voltage": 0x3120,
    "over_voltage": 0x3210,
    "under_voltage": 0x3220,
    "device_temperature": 0x4210,
    "drive_temperature": 0x4310,
    "software": 0x6100,
    "parameter": 0x6320,
    "motor_blocked": 0x7121,
    "encoder": 0x7305,
    "communication": 0x7500,
    "can_overrun": 0x8110,
    "can_passive": 0x8120,
    "heartbeat": 0x8130,
    "can_bus_off_recovered": 0x8140,
    "rpdo_timeout": 0x8250,
    "following_error": 0x8611,
    "reference_limit": 0x8612,
    "sync": 0x8700,
    "external": 0x9000,
    "vendor": 0xFF00,
}

_NODE: Final = Parameter(int, 0, minimum=0, maximum=127)  # 0: all
_AXIS: Final = Parameter(int, 0, minimum=0, maximum=7)
_INDEX: Final = Parameter(int, minimum=0x1000, maximum=0x9FFF)
_SUB: Final = Parameter(int, 0, minimum=0, maximum=255)
_WORD: Final = Parameter(int, 0, minimum=0, maximum=0xFFFF_FFFF)
_DELAY: Final = Parameter(float, minimum=0.0, maximum=10.0)
_ERROR: Final[Mapping[str, Parameter]] = {
    "node": _NODE,
    "axis": _AXIS,
    "error": Parameter(str, "generic", choices=tuple(ERRORS)),
    "code": Parameter(int, 0, minimum=0, maximum=0xFFFF),  # in place of a name
    "vendor": Parameter(str, ""),  # bytes of the manufacturer, in hexadecimal
}


def _lasting(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, {"node": _NODE, **parameters}, lasting=True)


KINDS: Final[dict[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind("fault", "the axis faults, and can be reset", _ERROR),
        FaultKind("lasting_fault", "the axis faults, and cannot be reset while this lasts",
                  _ERROR, lasting=True),
        FaultKind("emcy", "an emergency message, without a fault", _ERROR),
        FaultKind("reset", "the drive boots again by itself, whatever it does", {"node": _NODE}),
        _lasting("silent", "the cable is out: the drive runs on, hears and says nothing"),
        _lasting("power_off", "the electronics have no power; at the end the drive boots"),
        _lasting("supply_off", "the motor supply is off; the drive can be reached", axis=_AXIS),
        _lasting("safe_torque_off", "the STO inputs are active", axis=_AXIS),
        _lasting("local_control", "somebody at the drive controls it", axis=_AXIS),
        _lasting("stuck", "the motor does not turn", axis=_AXIS),
        _lasting("no_sdo", "SDO requests have no answer"),
        _lasting("slow_sdo", "SDO answers are late", delay=_DELAY),
        _lasting("sdo_abort", "accesses to an object are refused",
                 index=_INDEX, sub=_SUB, code=Parameter(int, 0x0800_0000, 0, 0xFFFF_FFFF)),
        _lasting("claim", "an object reads as these bytes (hexadecimal), also in TPDOs",
                 index=_INDEX, sub=_SUB, data=Parameter(str)),
        _lasting("ignored_writes", "writes to an object are accepted without effect", index=_INDEX),
        _lasting("no_heartbeat", "heartbeats are not sent"),
        _lasting("no_tpdo", "TPDOs are not sent"),
        _lasting("late_tpdo", "TPDOs are sent late", delay=_DELAY),
        _lasting("wrong_identity", "1018 has other values; 0 leaves one as it is",
                 vendor=_WORD, product=_WORD, revision=_WORD, serial=_WORD),
    )
}  # fmt: skip

EVENTS: Final = ("boot_up", "operational", "enabled", "moving", "faulted")
PLACES: Final = ("node", "axis", "index")

Parameters: TypeAlias = Mapping[str, Any]


def code_of(parameters: Parameters) -> int:
    """Error code that the parameters of a fault mean."""
    return int(parameters["code"] or ERRORS[parameters["error"]])


def _vendor(parameters: Parameters) -> bytes:
    return bytes.fromhex(parameters["vendor"])


def _set(name: str, value: str | bool = True) -> Callable[[Drive, Parameters, bool], None]:
    """Make the effect that sets a field of `drive.faults`, to a parameter when it is a name."""

    def effect(drive: Drive, parameters: Parameters, begin: bool) -> None:
        given = parameters[value] if isinstance(value, str) else value
        setattr(drive.faults, name, given if begin else type(given)())

    return effect


def _on_axis(change: Callable[[Axis, bool], None]) -> Callable[[Drive, Parameters, bool], None]:
    def effect(drive: Drive, parameters: Parameters, begin: bool) -> None:
        change(_axis(drive, parameters), begin)

    return effect


def _axis(drive: Drive, parameters: Parameters) -> Axis:
    return drive.axes[parameters["axis"]]


def _fault(drive: Drive, parameters: Parameters, begin: bool) -> None:
    _axis(drive, parameters).fault(code_of(parameters), _vendor(parameters))


def _lasting_fault(drive: Drive, parameters: Parameters, begin: bool) -> None:
    code = code_of(parameters)
    if begin:
        _axis(drive, parameters).fault(code, _vendor(parameters), persists=True)
    else:
        _axis(drive, parameters).recovered(code)


def _emcy(drive: Drive, parameters: Parameters, begin: bool) -> None:
    drive.emergency.once(code_of(parameters), _vendor(parameters))


def _sdo_abort(drive: Drive, parameters: Parameters, begin: bool) -> None:
    key = parameters["index"], parameters["sub"]
    if begin:
        drive.faults.sdo_aborts[key] = parameters["code"]
    else:
        drive.faults.sdo_aborts.pop(key, None)


def _claim(drive: Drive, parameters: Parameters, begin: bool) -> None:
    key = parameters["index"], parameters["sub"]
    if begin:
        drive.dictionary.claims[key] = bytes.fromhex(parameters["data"])
    else:
        drive.dictionary.claims.pop(key, None)


def _ignored(drive: Drive, parameters: Parameters, begin: bool) -> None:
    index = parameters["index"]
    if begin:
        drive.dictionary.ignored.add(index)
    elif index not in drive.config.personality.ignores:
        drive.dictionary.ignored.discard(index)


def _identity(drive: Drive, parameters: Parameters, begin: bool) -> None:
    for sub, name in enumerate(("vendor", "product", "revision", "serial"), 1):
        key = 0x1018, sub
        true = drive.dictionary.variables[key].initial(drive.node_id)
        drive.dictionary.values[key] = parameters[name] if begin and parameters[name] else true


def _set_local(axis: Axis, begin: bool) -> None:
    axis.local = begin


def _set_stuck(axis: Axis, begin: bool) -> None:
    axis.motor.stuck = begin


_EFFECTS: Final[dict[str, Callable[[Drive, Parameters, bool], None]]] = {
    "fault": _fault,
    "lasting_fault": _lasting_fault,
    "emcy": _emcy,
    "silent": _set("silent"),
    "supply_off": _on_axis(lambda axis, begin: axis.set_supply(not begin)),
    "safe_torque_off": _on_axis(Axis.set_safe_torque_off),
    "local_control": _on_axis(_set_local),
    "stuck": _on_axis(_set_stuck),
    "no_sdo": _set("no_sdo"),
    "slow_sdo": _set("sdo_delay", "delay"),
    "sdo_abort": _sdo_abort,
    "claim": _claim,
    "ignored_writes": _ignored,
    "no_heartbeat": _set("no_heartbeat"),
    "no_tpdo": _set("no_tpdo"),
    "late_tpdo": _set("tpdo_delay", "delay"),
    "wrong_identity": _identity,
}


def chosen(drives: Iterable[Drive], fault: Fault) -> list[Drive]:
    """Drives that a fault is for.

    Raises:
        FaultError: there is no such node or axis, or `vendor` is not hexadecimal.
    """
    parameters = fault.parameters
    node = parameters["node"]
    found = [drive for drive in drives if node in (0, drive.node_id)]
    if not found:
        raise FaultError(f"{fault.kind}: there is no drive with node-ID {node}")
    for drive in found:
        if parameters.get("axis", 0) >= len(drive.axes):
            raise FaultError(f"{fault.kind}: node {drive.node_id} has {len(drive.axes)} axes")
    try:
        bytes.fromhex(parameters[_BYTES[fault.kind]] if fault.kind in _BYTES else "")
    except ValueError as error:
        name = _BYTES[fault.kind]
        raise FaultError(f"{fault.kind}: {name} must be bytes in hexadecimal") from error
    return found


def apply(drive: Drive, fault: Fault, begin: bool, now: float) -> None:
    """Let a fault begin or end at a drive."""
    if fault.kind == "reset":
        drive.reset(now)
    elif fault.kind == "power_off":
        drive.switch(on=not begin, now=now)
    else:
        _EFFECTS[fault.kind](drive, fault.parameters, begin)


_BYTES: Final = {"fault": "vendor", "lasting_fault": "vendor", "emcy": "vendor", "claim": "data"}
"""Parameters of kinds that are bytes in hexadecimal."""
