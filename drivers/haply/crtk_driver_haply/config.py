"""What a user may set: the keys of the file, and the options of ``crtk-driver haply``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from crtk_drivers.commands import is_free_topic
from crtk_drivers.config import DeviceConfig

__all__ = ["BUTTONS", "HaplyConfig"]

BUTTONS: Final = ("a", "b", "c", "home")
"""What the service calls the buttons of a VerseGrip."""
_OTHERS: Final = frozenset({"state", "refusals"})
"""Names that are taken already."""


class HaplyConfig(DeviceConfig):
    """A Haply Inverse3, with a VerseGrip or without one."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The service": ("host", "port", "force_member"),
        "Which device": ("device_id", "grip", "grip_id", "buttons"),
        "Forces": ("max_force", "ramp"),
        "What it tells": ("rate", "base_frame", "tool_frame", "battery_low"),
        **DeviceConfig.HEADINGS,
    }

    host: str = Field(
        default="localhost",
        min_length=1,
        max_length=253,
        description="Machine on which Haply's Inverse service runs.",
    )
    port: int = Field(default=10001, ge=1, le=65535, description="Its simulation channel.")
    force_member: Literal["values", "vector"] = Field(
        default="values",
        description="What the service calls the three numbers of a force: `values`, as Haply's own clients "
        "send them, or `vector`, as the manual of 3.5 has it.",
    )
    device_id: str = Field(
        default="",
        max_length=64,
        description="Of the Inverse3, as the service tells it (`049D`); empty: the only one.",
    )
    grip: bool = Field(
        default=True,
        description="Orientation and buttons come from a VerseGrip. False: the orientation is 0, 0, 0, 1.",
    )
    grip_id: str = Field(
        default="", max_length=64, description="Of the VerseGrip; empty: the only one."
    )
    buttons: dict[str, Literal["a", "b", "c", "home"]] = Field(
        default_factory=lambda: {f"button_{name}": name for name in BUTTONS},
        description="Button of the VerseGrip by the name of its topic: { clutch = 'a' }.",
    )
    max_force: float = Field(
        default=3.0,
        gt=0.0,
        le=20.0,
        description="In N; a greater one is refused. What the device can exert, its manual tells.",
    )
    ramp: float = Field(
        default=0.1,
        ge=0.0,
        le=5.0,
        description="Seconds in which the force of a stream that begins grows to what was asked for.",
    )
    rate: float = Field(default=500.0, ge=50.0, le=1000.0, description="Of the I/O cycle, in Hz.")
    base_frame: str = Field(
        default="haply_base", min_length=1, max_length=100, description="Frame of measured_cp."
    )
    tool_frame: str = Field(
        default="haply", min_length=1, max_length=100, description="Frame of the handle."
    )
    battery_low: float = Field(
        default=0.2, ge=0.0, le=1.0, description="Charge of a grip, of 1, below which it is told."
    )
    stream_timeout: float = Field(
        default=0.05,
        gt=0.0,
        le=0.5,
        description="A force is zero when no command came for this long, in s.",
    )

    @model_validator(mode="after")
    def _buttons_have_names(self) -> Self:
        for name in self.buttons:
            if not is_free_topic(name, _OTHERS):
                raise ValueError(f"buttons: {name!r} is no name for a topic, or is taken")
        return self
