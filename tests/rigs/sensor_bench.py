"""A force sensor's simulator in its own process, and its driver in this one."""

from __future__ import annotations

import numpy as np

from rigs.device_bench import DeviceBench
from rigs.waiting import eventually


class SensorBench(DeviceBench):
    """A driver and the simulator that it is connected to."""

    def measures(self, load: list[float], name: str = "measured_cf", child: str = "") -> None:
        """Wait until it, or a sensor behind it, measures a load, N and N·m."""
        engine = self.session.children[child] if child else self.session.engine

        def is_there() -> bool:
            found = engine.feedback(name)
            return found is not None and bool(np.allclose(found[0].vector, load, atol=0.5))

        eventually(is_there, f"{load}")

    def note(self, key: str, text: str = "") -> None:
        """Wait until a note of the device has a text."""

        def is_told() -> bool:
            notes = self.session.engine.device.notes
            return any(note.key == key and text in note.text for note in notes)

        eventually(is_told, f"a note {key}: {text}")
