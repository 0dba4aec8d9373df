"""Small classes that the official client has beside ``ral`` and ``utils``."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from crtk_drivers.client.compat.utilities import Utils
from crtk_drivers.client.ral import Joy, Ral


class JoystickButton:
    """One button of a sensor_msgs/Joy topic, for example a foot pedal."""

    def __init__(self, ral: Ral, button_name: str, index: int = 0) -> None:
        self._index = index
        self._value: int | None = None
        self._user_callback: Callable[[int], Any] | None = None
        self._changed = threading.Condition()
        self._count = 0
        ral.subscriber(button_name, Joy, self._receive)

    def _receive(self, message: Any) -> None:
        value = int(message.buttons[self._index])
        with self._changed:
            self._value = value
            self._count += 1
            self._changed.notify_all()
        if self._user_callback is not None:
            self._user_callback(value)

    def set_callback(self, callback: Callable[[int], Any] | None = None) -> None:
        """Call `callback` with each value; None ends that."""
        self._user_callback = callback

    def value(self) -> int | None:
        """Return the last value, None before there was one."""
        return self._value

    def wait(self, timeout: float | None = None, value: int | None = None) -> bool:
        """Wait for the next event, or the next one with `value`; return whether it came in time."""
        end = None if timeout is None else time.monotonic() + timeout
        with self._changed:
            while True:
                count = self._count
                left = None if end is None else end - time.monotonic()
                if not self._changed.wait_for(partial(self._is_after, count), left):
                    return False
                if value is None or value == self._value:
                    return True

    def _is_after(self, count: int) -> bool:
        return self._count > count


class MeasuredCp:
    """An object with ``measured_cp()`` and nothing besides."""

    def __init__(self, ral: Ral, expected_interval: float = 0.01) -> None:
        Utils(self, ral, expected_interval).add_measured_cp()
