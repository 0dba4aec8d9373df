"""What a user may set: the keys of the file, and the options of ``crtk-driver inputs``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from crtk_driver_inputs import spacenav
from crtk_drivers.commands import is_free_topic
from crtk_drivers.config import DeviceConfig

__all__ = ["InputsConfig"]

_OTHERS: Final = frozenset({"joy", "state", "refusals"})
"""Names that are taken already."""


class InputsConfig(DeviceConfig):
    """Foot pedals, a joystick, or a six-axis mouse."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The way to it": ("link", "path", "grab"),
        "What it tells": ("pedals", "frame_id", "rate"),
        "Six-axis mice": ("speed", "turn_speed", "full_scale", "deadband", "silence"),
    }

    link: Literal["evdev", "js", "spacenavd"] = Field(
        default="evdev",
        description="An event device of the kernel (pedals, buttons); a joystick device; or the socket of "
        "spacenavd.",
    )
    path: str = Field(
        default="",
        description="/dev/input/by-id/...-event-kbd, /dev/input/js0, or the socket; "
        f"{spacenav.SOCKET} if empty.",
    )
    grab: bool = Field(
        default=False,
        description="Of evdev: nobody else gets its events, so that a pedal types no letters. Not for the "
        "keyboard that you sit at.",
    )
    pedals: dict[str, int] = Field(
        default_factory=dict,
        description="Code of each by the name of its topic: { clutch = 30 }. Of evdev a code of "
        "input-event-codes.h, else the number of the button.",
    )
    frame_id: str = Field(
        default="mouse", min_length=1, max_length=100, description="Frame of a mouse."
    )
    rate: float = Field(default=100.0, ge=10.0, le=1000.0, description="Samples a second.")
    speed: float = Field(
        default=0.1,
        gt=0.0,
        le=10.0,
        description="Of a mouse that is pushed as far as it goes, in m/s.",
    )
    turn_speed: float = Field(default=0.5, gt=0.0, le=20.0, description="The same in rad/s.")
    full_scale: float = Field(
        default=350.0, gt=0.0, le=1e5, description="Counts of a mouse that is pushed so far."
    )
    deadband: float = Field(
        default=0.05, ge=0.0, lt=1.0, description="Share of that which moves nothing."
    )
    silence: float = Field(
        default=0.5,
        gt=0.0,
        le=10.0,
        description="Seconds after which a mouse that was pushed and tells nothing more is let go.",
    )

    @model_validator(mode="after")
    def _pedals_have_names(self) -> Self:
        for name, code in self.pedals.items():
            if not is_free_topic(name, _OTHERS):
                raise ValueError(f"pedals: {name!r} is no name for a topic, or is taken")
            if not 0 <= code <= 0x2FF:
                raise ValueError(f"pedals: {name}: {code} is no code, 0 to 767")
        if self.grab and self.link != "evdev":
            raise ValueError("grab: is of the link evdev")
        return self

    @property
    def place(self) -> str:
        """Path of the device or socket."""
        return self.path or (spacenav.SOCKET if self.link == "spacenavd" else "")
