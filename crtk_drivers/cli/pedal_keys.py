"""Keys of a terminal that stand for pedals: each press of one is a press or, the next time, a letting go."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from crtk_drivers.errors import ConfigError
from crtk_drivers.motion.teleop.both_sides import Heard
from crtk_drivers.motion.teleop.teleop_settings import SPACE


class KeyPedal:
    """A key. A terminal tells no release, so the key toggles; nothing is pressed at the start."""

    doubt = ""

    def __init__(self, keys: Keys, key: str) -> None:
        self._keys = keys
        self._key = " " if key == SPACE else key
        keys.pressed[self._key] = False

    def read(self) -> Heard[bool] | None:
        """Return whether it is pressed; None when the terminal is gone."""
        self._keys.look()
        if self._keys.ended:
            return None
        return Heard(self._keys.pressed[self._key], time.monotonic())


class Keys:
    """What is typed at a terminal, without waiting for it.

    Args:
        descriptor: of the terminal, which gives single keys.

    Attributes:
        pressed: by key; what is not in it is nobody's.
        ended: nothing will come any more.
    """

    def __init__(self, descriptor: int) -> None:
        self.pressed: dict[str, bool] = {}
        self.ended = False
        self._descriptor = descriptor

    def look(self) -> None:
        """Take what was typed since the last look."""
        while not self.ended and select.select([self._descriptor], [], [], 0.0)[0]:
            try:
                typed = os.read(self._descriptor, 64)
            except OSError:
                typed = b""
            self.ended = not typed
            for key in typed.decode("ascii", "replace"):
                if key in self.pressed:
                    self.pressed[key] = not self.pressed[key]


@contextmanager
def keys_of(wanted: Mapping[str, str]) -> Iterator[dict[str, KeyPedal]]:
    """Pedals for the keys that are wanted, by the names of the pedals; the terminal is given back.

    Raises:
        ConfigError: a key is wanted, and standard input is no terminal.
    """
    if not wanted:
        yield {}
        return
    if not sys.stdin.isatty():
        raise ConfigError(
            "there is no terminal to press it at",
            where=f"key {', '.join(wanted.values())}",
            remedy="Start it at a terminal, or give the topic of a pedal.",
        )
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        keys = Keys(descriptor)
        yield {name: KeyPedal(keys, key) for name, key in wanted.items()}
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
