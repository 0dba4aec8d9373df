"""A device that hangs at another one: a gripper at the tool of an arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field, model_validator

from crtk_drivers.config.settings import Settings

__all__ = ["AttachedConfig"]


class AttachedConfig(Settings):
    """Which device it is, and its own configuration. The name alone may stand for all of it."""

    SHORTHAND: ClassVar[str] = "plugin"
    """The key whose value may stand for the whole table, as in ``--gripper robotiq``."""

    plugin: str = Field(min_length=1, max_length=100, description="Its driver, as `robotiq`.")
    settings: Mapping[str, Any] = Field(
        default_factory=dict,
        description="Keys of its own configuration; it is reached through the tool unless they say "
        "otherwise.",
    )

    @model_validator(mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:
        return {cls.SHORTHAND: value} if isinstance(value, str) else value
