"""A device that hangs at another one: a gripper at the tool of an arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from crtk_drivers.config.settings import Settings

__all__ = ["AttachedConfig", "BehindConfig", "GripLoadConfig", "LoadConfig"]

Small = Annotated[float, Field(ge=-10.0, le=10.0)]


class BehindConfig(Settings):
    """How a device behind an arm is met by programs."""

    name: Literal["gripper", "jaw"] = Field(
        default="gripper",
        description="Its sub-namespace, and what it is called in Python; dVRK calls it `jaw`.",
    )
    own_state: bool = Field(
        default=True,
        description="Whether it has an operating state of its own; otherwise it is enabled, paused and "
        "disabled with the arm, whose state is busy while it moves, as programs for dVRK expect it.",
    )


class LoadConfig(Settings):
    """What an arm carries behind its flange, gripper and all."""

    mass: float = Field(ge=0.0, le=100.0, description="In kg.")
    center_of_gravity: tuple[Small, Small, Small] = Field(
        default=(0.0, 0.0, 0.0), description="From the flange, in its axes, in m."
    )
    tcp: tuple[Small, Small, Small, Small, Small, Small] | None = Field(
        default=None,
        description="Tool centre point from the flange: m and a rotation vector in rad; as it is if null.",
    )


class GripLoadConfig(Settings):
    """Payload, and perhaps tool centre point, of an arm by what its gripper holds."""

    empty: LoadConfig = Field(description="While it holds nothing.")
    holding: LoadConfig = Field(description="While it holds something.")

    @model_validator(mode="after")
    def _both_or_none(self) -> GripLoadConfig:
        if (self.empty.tcp is None) is not (self.holding.tcp is None):
            raise ValueError("tcp: give that of empty and of holding, or of neither")
        return self


class AttachedConfig(BehindConfig):
    """Which device it is, and its own configuration. The name alone may stand for all of it."""

    SHORTHAND: ClassVar[str] = "plugin"
    """The key whose value may stand for the whole table, as in ``--gripper robotiq``."""

    plugin: str = Field(min_length=1, max_length=100, description="Its driver, as `robotiq`.")
    payload_of_grip: GripLoadConfig | None = Field(
        default=None,
        description="The arm's payload follows what is gripped: when the gripper says that it holds "
        "something, or does not any more, the arm is told, once both rest. Untouched if null.",
    )
    settings: Mapping[str, Any] = Field(
        default_factory=dict,
        description="Keys of its own configuration; it is reached through the tool unless they say "
        "otherwise.",
    )

    @model_validator(mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:
        return {cls.SHORTHAND: value} if isinstance(value, str) else value
