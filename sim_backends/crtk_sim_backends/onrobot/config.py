"""The options of the simulated gripper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from typing_extensions import override

from crtk_sim_backends.kit import check_choice, check_range, option
from crtk_sim_backends.kit.modbus_server import ModbusOptions
from crtk_sim_backends.onrobot.models import MODELS


@dataclass(frozen=True, kw_only=True)
class SimConfig(ModbusOptions):
    """The options of ``crtk-driver sim onrobot``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The gripper": (
            "model",
            "serial",
            "closed",
            "lower",
            "upper",
            "offset",
            "start_lag",
            "unit",
        ),
        "What there is to grip": ("object_width", "object_stiffness", "leak"),
        "Ports": ModbusOptions.PORTS,
        **ModbusOptions.HEADINGS,
    }

    model: str = option("rg2", "which gripper", choices=tuple(MODELS))
    serial: str = option("SIM0001", "serial number")
    closed: float = option(0.5, "how far it is closed at the start, from 0 to 1")
    lower: float = option(-1.0, "least opening with its fingers, in m; below 0: the model's")
    upper: float = option(-1.0, "greatest opening with its fingers, in m; below 0: the model's")
    offset: float = option(0.0, "thickness of each fingertip, in m (RG)")
    start_lag: float = option(0.02, "seconds between a command and the flag busy")
    unit: int = option(65, "its Modbus address")
    baud: int = option(1_000_000, "bits a second of its serial lines; 0: as fast as it goes")
    turnaround: float = option(0.0005, "seconds between a request and its answer on these")
    object_width: float = option(0.0, "width of what lies between the fingers, in m; 0: nothing")
    object_stiffness: float = option(1e5, "of what lies there, in N/m")
    leak: float = option(0.0, "share of the vacuum that is lost in a second (VG)")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("model", self.model, MODELS)
        check_range("closed", self.closed, 0.0, 1.0)
        check_range("lower", self.lower, -1.0, 0.2)
        check_range("upper", self.upper, -1.0, 0.3)
        check_range("offset", self.offset, 0.0, 0.02)
        check_range("start_lag", self.start_lag, 0.0, 1.0)
        check_range("object_width", self.object_width, 0.0, 0.2)
        check_range("object_stiffness", self.object_stiffness, 100.0, 1e9)
        check_range("leak", self.leak, 0.0, 100.0)
