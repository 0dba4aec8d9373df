"""Build a message package by scikit-build-core, once the machine has what that needs (pyproject.toml)."""

from __future__ import annotations

import sys
from typing import Any

import build_needs
from scikit_build_core import build

build_editable = build.build_editable
build_sdist = build.build_sdist
build_wheel = build.build_wheel
get_requires_for_build_sdist = build.get_requires_for_build_sdist
prepare_metadata_for_build_editable = build.prepare_metadata_for_build_editable
prepare_metadata_for_build_wheel = build.prepare_metadata_for_build_wheel


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Return what scikit-build-core needs; end with one line if the machine has no compiler or no headers."""
    _check_machine()
    return build.get_requires_for_build_wheel(config_settings)


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """Return the same for a package that is installed in place."""
    _check_machine()
    return build.get_requires_for_build_editable(config_settings)


def _check_machine() -> None:
    found = build_needs.complaint(("compiler", "headers"))
    if found:
        sys.exit(f"The ROS 2 messages cannot be compiled: {found}")
