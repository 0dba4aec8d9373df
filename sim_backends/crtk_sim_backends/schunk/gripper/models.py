"""The simulated models and their modules, as data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

MODELS: Final[Mapping[str, int]] = {
    "egu-50": 6, "egu-60": 7, "egu-70": 8, "egu-80": 9,
    "egu-50-m": 10, "egu-60-m": 11, "egu-70-m": 12, "egu-80-m": 13,
    "egk-25": 14, "egk-40": 15, "egk-50": 16, "egk-25-m": 17, "egk-40-m": 18, "egk-50-m": 19,
    "ezu-30": 28, "ezu-35": 29, "ezu-40": 30, "ezu-30-m": 31, "ezu-35-m": 32, "ezu-40-m": 33,
}  # fmt: skip
"""Module types by name."""

FIELDBUSES: Final[Mapping[str, int]] = {
    "profinet": 1,
    "ethernet-ip": 2,
    "ethercat": 3,
    "modbus-rtu": 7,
}
