"""What plugins for the axes of motion controllers say alike, of real ones and of simulated ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from crtk_drivers.config import DeviceConfig
from crtk_drivers.errors import ConfigError

__all__ = ["check_real", "with_joints"]

ConfigT = TypeVar("ConfigT", bound=DeviceConfig)


def check_real(device: str, examples: Mapping[str, str]) -> Callable[[DeviceConfig], None]:
    """Return a `DevicePlugin.check_real` that asks for all of some keys.

    Args:
        device: the plugin, which has a page of its name in the documentation.
        examples: by key, how it is given.
    """

    def check(config: DeviceConfig) -> None:
        for key, example in examples.items():
            if not getattr(config, key):
                raise ConfigError(
                    f"{key}: is required for real hardware",
                    where=device,
                    remedy=f"Give it ({example}; docs/{device}.md has a file), or use --sim.",
                )

    return check


def with_joints(config: ConfigT, typical: Mapping[str, Any]) -> ConfigT:
    """Return a configuration with joints: its own, or typical ones where it has none."""
    if getattr(config, "joints"):  # noqa: B009 - each driver has joints of its own kind
        return config
    return type(config)(**{**config.model_dump(exclude_unset=True), **typical})
