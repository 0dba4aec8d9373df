"""The options of the simulated gripper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from typing_extensions import override

from crtk_sim_backends.kit import Options, check_choice, check_port, check_range, option
from crtk_sim_backends.weiss_wsg.models import MODELS


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim weiss-wsg``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The gripper": (
            "model",
            "referenced",
            "opening",
            "fast_stop_on_disconnect",
            "while_moving",
            "clamping_travel",
            "homing_speed",
            "text_flags",
            "defects",
        ),
        "What lies between its fingers": ("part_width", "part_stiffness"),
        "Ports": ("binary_port", "text_port"),
        **Options.HEADINGS,
    }

    model: str = option("wsg-50-110", "which gripper", choices=tuple(MODELS))
    referenced: bool = option(True, "it has found its reference; otherwise it is as powered on")
    opening: float = option(0.05, "opening at the start, in m")
    fast_stop_on_disconnect: bool = option(
        True, "it stops fast when a TCP connection ends without a goodbye, as its web page can set"
    )
    while_moving: str = option(
        "replace",
        "a motion that is asked for during another takes its place, or is refused",
        choices=("replace", "refuse"),
    )
    clamping_travel: float = option(
        0.005, "by how much it closes beyond the width of a part to find it, in m"
    )
    homing_speed: float = option(0.2, "how fast it goes to find its reference, in m/s")
    text_flags: bool = option(True, "its text mode tells the flags of the system state")
    defects: str = option(
        "", "of what it tells: such as position_noise=1e-4,velocity_scale=2,effort_sign=-1"
    )
    part_width: float = option(0.0, "width of what lies between the fingers, in m; 0: nothing")
    part_stiffness: float = option(1e5, "of what lies there, in N/m")
    binary_port: int = option(
        11000, "TCP port of the binary protocol (1000 on hardware); 0: any free one"
    )
    text_port: int = option(
        11001,
        "TCP port of the text mode, which on hardware takes the place of it; 0: any free one",
    )

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("model", self.model, MODELS)
        check_choice("while_moving", self.while_moving, ("replace", "refuse"))
        stroke = MODELS[self.model].stroke / 1e3
        check_range("opening", self.opening, 0.0, stroke)
        check_range("clamping_travel", self.clamping_travel, 0.0, 0.05)
        check_range("homing_speed", self.homing_speed, 0.001, 1.0)
        check_range("part_width", self.part_width, 0.0, stroke)
        check_range("part_stiffness", self.part_stiffness, 100.0, 1e9)
        for name in ("binary_port", "text_port"):
            check_port(name, getattr(self, name))
