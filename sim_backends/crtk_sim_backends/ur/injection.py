"""The faults that a simulated UR controller can have, as a table for fault files and injection.

Those of `wire_kinds` happen to one port (or "all"), the others to the controller.
`stall` freezes the whole controller: nothing is sent, received or moved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from crtk_sim_backends.faults import FaultKind, Parameter
from crtk_sim_backends.kit import ALL_PORTS, wire_kinds
from crtk_sim_backends.ur.config import PORTS
from crtk_sim_backends.ur.motion.contact import DAMPING, STIFFNESS, UP, Surface
from crtk_sim_backends.ur.safety.modes import SafetyMode
from crtk_sim_backends.ur.signals.control_box import ANALOG_INPUTS
from crtk_sim_backends.ur.signals.registers import FIELDBUS_INPUTS, fieldbus_value
from crtk_sim_backends.ur.signals.variables import OUTPUTS

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller

Parameters = Mapping[str, Any]

EVENTS: Final = (
    *(f"{name}_connected" for name in PORTS),
    "program_started",
    "program_stopped",
    "motion_started",
    "motion_stopped",
)
"""What an entry of a fault file can wait for with `when`."""

_PORT: Final = Parameter(str, choices=(*PORTS, ALL_PORTS))

REAL_OUTPUTS: Final = tuple(
    name
    for name, variable in OUTPUTS.items()
    if variable.type in ("DOUBLE", "VECTOR3D", "VECTOR6D")
)
"""Outputs of RTDE that can be no number at all."""

_FAILING_PROGRAM: Final = "def simulated_error():\n  values = [0]\n  textmsg(values[5])\nend\n"

BEGIN: Final[Mapping[str, Callable[[Controller, Parameters], object]]] = {
    "protective_stop": lambda c, p: c.protective_stop(p["code"]),
    "emergency_stop": lambda c, p: c.emergency_stop(),
    "system_emergency_stop": lambda c, p: c.emergency_stop(SafetyMode.SYSTEM_EMERGENCY_STOP),
    "safeguard_stop": lambda c, p: c.safeguard_stop(True),
    "automatic_safeguard_stop": lambda c, p: c.automatic_safeguard_stop(True),
    "enabling_device_released": lambda c, p: c.hold_enabling_device(False),
    "recovery_mode": lambda c, p: c.recovery_mode(True),
    "reduced_mode": lambda c, p: c.reduced_mode(True),
    "local_control": lambda c, p: c.set_remote(False),
    "violation": lambda c, p: c.violation(),
    "safety_fault": lambda c, p: c.fault(),
    "power_loss": lambda c, p: c.power_loss(),
    "freeze_joint": lambda c, p: c.freeze_joint(p["joint"], True),
    "external_force": lambda c, p: c.external_force(p["wrench"]),
    "spoiled_output": lambda c, p: c.spoiled.update(
        {p["variable"]: (p["index"], float(p["value"]))}
    ),
    "surface": lambda c, p: c.surroundings.place(
        p["index"],
        Surface.make(
            p["point"],
            p["normal"] if any(p["normal"]) else UP,
            p["stiffness"],
            p["damping"],
            p["friction"],
        ),
    ),
    "stop_program": lambda c, p: c.stop(),
    "pause_program": lambda c, p: c.pause(),
    "script_error": lambda c, p: c.run_script(_FAILING_PROGRAM),
    "speed_slider": lambda c, p: c.write_inputs(
        {"speed_slider_mask": 1, "speed_slider_fraction": p["fraction"]}
    ),
    "conveyor": lambda c, p: c.encoders.move(p["encoder"], p["ticks"]),
    "fieldbus_input": lambda c, p: c.write_inputs(
        {p["register"]: fieldbus_value(p["register"], p["value"])}
    ),
    "digital_inputs": lambda c, p: c.signals.set_digital_inputs(p["bits"]),
    "analog_input": lambda c, p: c.signals.set_analog_input(p["signal"], p["value"]),
}
"""What the kinds that happen to the robot do when they begin."""

END: Final[Mapping[str, Callable[[Controller, Parameters], object]]] = {
    "emergency_stop": lambda c, p: c.release_emergency_stop(),
    "system_emergency_stop": lambda c, p: c.release_emergency_stop(
        SafetyMode.SYSTEM_EMERGENCY_STOP
    ),
    "safeguard_stop": lambda c, p: c.safeguard_stop(False),
    "automatic_safeguard_stop": lambda c, p: c.automatic_safeguard_stop(False),
    "enabling_device_released": lambda c, p: c.hold_enabling_device(True),
    "recovery_mode": lambda c, p: c.recovery_mode(False),
    "reduced_mode": lambda c, p: c.reduced_mode(False),
    "local_control": lambda c, p: c.set_remote(True),
    "freeze_joint": lambda c, p: c.freeze_joint(p["joint"], False),
    "external_force": lambda c, p: c.external_force((0.0,) * 6),
    "spoiled_output": lambda c, p: c.spoiled.pop(p["variable"], None),
    "surface": lambda c, p: c.surroundings.place(p["index"], None),
    "pause_program": lambda c, p: c.play(),
    "speed_slider": lambda c, p: c.write_inputs(
        {"speed_slider_mask": 1, "speed_slider_fraction": 1.0}
    ),
    "conveyor": lambda c, p: c.encoders.move(p["encoder"], 0.0),
    "digital_inputs": lambda c, p: c.signals.set_digital_inputs(0),
    "analog_input": lambda c, p: c.signals.set_analog_input(p["signal"], 0.0),
}
"""What they do when they are cleared; kinds that are not here cannot be."""


def _robot_kind(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, parameters, lasting=name in END)


KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind("stall", "the whole controller hangs", {}, lasting=True),
        *wire_kinds(_PORT).values(),
        _robot_kind(
            "protective_stop",
            "the robot stops protectively",
            code=Parameter(int, 0, minimum=0, maximum=2**31 - 1),
        ),
        _robot_kind("emergency_stop", "the emergency stop is pressed; cleared: released"),
        _robot_kind("safeguard_stop", "the safeguard input opens; cleared: closes"),
        _robot_kind("system_emergency_stop", "the same with the emergency stop of the cell"),
        _robot_kind("automatic_safeguard_stop", "the safeguard input of automatic mode opens"),
        _robot_kind(
            "enabling_device_released", "the three-position device is let go of (manual mode)"
        ),
        _robot_kind("reduced_mode", "the safety mode is REDUCED"),
        _robot_kind("recovery_mode", "the safety mode is RECOVERY"),
        _robot_kind("local_control", "somebody switches to local control on the pendant"),
        _robot_kind("violation", "the safety system reports a violation"),
        _robot_kind("safety_fault", "the safety system reports a fault"),
        _robot_kind("power_loss", "the arm loses its power"),
        _robot_kind(
            "freeze_joint",
            "a joint is blocked mechanically",
            joint=Parameter(int, minimum=0, maximum=5),
        ),
        _robot_kind(
            "external_force",
            "somebody pushes at the TCP (N, N.m, axes of the base)",
            wrench=Parameter(list, minimum=-10000.0, maximum=10000.0, length=6),
        ),
        _robot_kind(
            "spoiled_output",
            "RTDE clients are told nonsense in an output",
            variable=Parameter(str, choices=REAL_OUTPUTS),
            index=Parameter(int, 0, minimum=0, maximum=5),
            value=Parameter(str, "nan", choices=("nan", "inf", "-inf", "1e308")),
        ),
        _robot_kind(
            "surface",
            "something flat for the tool to touch, such as a table (m, N/m, N.s/m, base frame)",
            point=Parameter(list, minimum=-10.0, maximum=10.0, length=3),
            normal=Parameter(list, UP, minimum=-1.0, maximum=1.0, length=3),
            stiffness=Parameter(float, STIFFNESS, minimum=1.0, maximum=1e6),
            damping=Parameter(float, DAMPING, minimum=0.0, maximum=1e5),
            friction=Parameter(float, 0.0, minimum=0.0, maximum=2.0),
            index=Parameter(int, 0, minimum=0, maximum=99),
        ),
        _robot_kind("stop_program", "somebody presses stop on the pendant"),
        _robot_kind("pause_program", "somebody presses pause; cleared: play"),
        _robot_kind("script_error", "a program that fails at run time replaces the running one"),
        _robot_kind(
            "speed_slider",
            "somebody moves the speed slider; cleared: back to 100 %",
            fraction=Parameter(float, minimum=0.0, maximum=1.0),
        ),
        _robot_kind(
            "fieldbus_input",
            "the PLC at the other end of EtherNet/IP or PROFINET sets a register",
            register=Parameter(str, choices=FIELDBUS_INPUTS),
            value=Parameter(float, minimum=-(2.0**31), maximum=2.0**32 - 1.0),
        ),
        _robot_kind(
            "conveyor",
            "a belt turns an encoder that decodes pulses (ticks/s); cleared: it stands",
            encoder=Parameter(int, 0, minimum=0, maximum=1),
            ticks=Parameter(float, minimum=-40000.0, maximum=40000.0),
        ),
        _robot_kind(
            "digital_inputs",
            "digital inputs are on (bits 0-7 standard, 8-15 configurable, 16-17 tool)",
            bits=Parameter(int, minimum=0, maximum=2**18 - 1),
        ),
        _robot_kind(
            "analog_input",
            "an analog input measures a value (V or A, by its type)",
            signal=Parameter(str, choices=ANALOG_INPUTS),
            value=Parameter(float, minimum=0.0, maximum=30.0),
        ),
    )
}
"""Every kind of fault, by name."""
