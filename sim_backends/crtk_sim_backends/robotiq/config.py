"""The options of the simulated gripper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from typing_extensions import override

from crtk_sim_backends.defects import read_one
from crtk_sim_backends.kit import check_choice, check_port, check_range, option
from crtk_sim_backends.kit.modbus_server import ModbusOptions
from crtk_sim_backends.robotiq.defects import GripperDefects
from crtk_sim_backends.robotiq.models import MODELS


@dataclass(frozen=True, kw_only=True)
class SimConfig(ModbusOptions):
    """The options of ``crtk-driver sim robotiq``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The gripper": (
            "model",
            "activated",
            "closed",
            "band_open",
            "band_closed",
            "object_lag",
            "sweep_speed",
            "defects",
            "unit",
        ),
        "What lies between its fingers": ("object_width", "object_stiffness"),
        "Ports": (
            *ModbusOptions.PORTS,
            "controller_port",
            "controller_unit",
            "urcap_port",
            "urcap_newline",
        ),
        **ModbusOptions.HEADINGS,
    }

    model: str = option("2f-85", "which gripper", choices=tuple(MODELS))
    activated: bool = option(
        True, "somebody has activated it before; otherwise it is as powered on"
    )
    closed: float = option(0.5, "how far it is closed at the start, from 0 to 1")
    band_open: float = option(3.0, "count (gPO) at which it is open as far as it goes")
    band_closed: float = option(230.0, "count at which it is closed as far as it goes")
    object_lag: float = option(0.003, "gOBJ is told so many s late; the echo of a request is not")
    sweep_speed: float = option(
        0.0, "speed of its fingers in an activation, in m/s; 0: the greatest of the model"
    )
    defects: str = option("", "what is wrong with it: short, blind, imagines, gives_way (docs)")
    unit: int = option(9, "its Modbus address")
    object_width: float = option(0.0, "width of what lies between the fingers, in m; 0: nothing")
    object_stiffness: float = option(1e5, "of what lies there, in N/m")
    controller_port: int = option(
        1503, "port of Robotiq's own controller in Modbus TCP (502 on hardware); 0: any free one"
    )
    controller_unit: int = option(2, "its Modbus address there")
    urcap_port: int = option(63352, "port of the URCap's text server; 0: any free one")
    urcap_newline: bool = option(True, "the text server ends what it answers to GET with a newline")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("model", self.model, MODELS)
        check_range("closed", self.closed, 0.0, 1.0)
        check_range("band_open", self.band_open, 0.0, 100.0)
        check_range("band_closed", self.band_closed, 101.0, 255.0)
        check_range("object_lag", self.object_lag, 0.0, 0.1)
        check_range("sweep_speed", self.sweep_speed, 0.0, 0.5)
        check_range("object_width", self.object_width, 0.0, 0.2)
        check_range("object_stiffness", self.object_stiffness, 100.0, 1e9)
        check_port("urcap_port", self.urcap_port)
        check_port("controller_port", self.controller_port)
        check_range("controller_unit", self.controller_unit, 1, 247)
        _ = self.gripper_defects

    @property
    def gripper_defects(self) -> GripperDefects:
        """What `defects` says."""
        return read_one(GripperDefects, self.defects)
