"""The options of the simulated gripper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from typing_extensions import override

from crtk_sim_backends.kit import check_choice, check_port, check_range, option
from crtk_sim_backends.kit.modbus_server import ModbusOptions
from crtk_sim_backends.schunk.gripper.models import FIELDBUSES, MODELS


@dataclass(frozen=True, kw_only=True)
class SimConfig(ModbusOptions):
    """The options of ``crtk-driver sim schunk``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The gripper": (
            "model",
            "fieldbus",
            "acknowledged",
            "opening",
            "lower",
            "upper",
            "speed",
            "grip_speed",
            "max_force",
            "unit",
        ),
        "What lies between its fingers": ("object_width", "object_stiffness"),
        "Ports": ("http_port", *ModbusOptions.PORTS),
        **ModbusOptions.HEADINGS,
    }

    model: str = option("egk-40-m", "which gripper; m has a brake", choices=tuple(MODELS))
    fieldbus: str = option(
        "ethernet-ip", "of its module: profinet has big-endian numbers", choices=tuple(FIELDBUSES)
    )
    acknowledged: bool = option(
        True, "it is ready; otherwise it is as powered on, with error EF (no fieldbus)"
    )
    opening: float = option(0.04, "between its fingers at the start, in m")
    lower: float = option(0.0, "opening when it is closed, in m")
    upper: float = option(0.083, "opening when it is open, in m")
    speed: float = option(0.115, "its greatest speed, in m/s")
    grip_speed: float = option(0.022, "that of a grip with all its force, in m/s")
    max_force: float = option(150.0, "its greatest force, in N")
    unit: int = option(12, "its Modbus address")
    object_width: float = option(0.0, "width of what lies between the fingers, in m; 0: nothing")
    object_stiffness: float = option(1e5, "of what lies there, in N/m")
    http_port: int = option(8080, "port of its web server (80 on hardware); 0: any free one")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("model", self.model, MODELS)
        check_choice("fieldbus", self.fieldbus, FIELDBUSES)
        check_range("lower", self.lower, -1.0, 1.0)
        check_range("upper", self.upper, self.lower + 1e-3, 1.0)
        check_range("opening", self.opening, -1.0, 1.0)
        check_range("speed", self.speed, 1e-3, 10.0)
        check_range("grip_speed", self.grip_speed, 1e-3, 10.0)
        check_range("max_force", self.max_force, 1.0, 1e5)
        check_range("object_width", self.object_width, 0.0, 0.2)
        check_range("object_stiffness", self.object_stiffness, 100.0, 1e9)
        check_port("http_port", self.http_port)
