"""A simulated UR controller in virtual time, for tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from crtk_sim_backends.ur.controller import Controller
from crtk_sim_backends.ur.messages import Message
from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.safety.modes import RuntimeState


class Bench:
    """A controller, the messages it sent so far, and ways to let time pass."""

    def __init__(self, model: str = "ur5e", **options: Any) -> None:
        newest = (3, 15, 8, 0) if MODELS[model].is_cb3 else (5, 26, 0, 0)
        version = options.pop("version", newest)
        self.controller = Controller(MODELS[model], version, **options)
        self.messages: list[Message] = []

    def __getitem__(self, name: str) -> Any:
        return self.controller.outputs[name]

    @property
    def arm(self) -> Any:
        return self.controller.plant.arm

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.controller.tick()
        self.messages += self.controller.take_messages()

    def seconds(self, seconds: float) -> None:
        self.ticks(round(seconds / self.controller.dt))

    def until(self, condition: Callable[[], bool], seconds: float = 30.0) -> int:
        """Tick until `condition` holds; returns the number of ticks."""
        limit = round(seconds / self.controller.dt)
        for count in range(limit):
            if condition():
                return count
            self.ticks(1)
        raise AssertionError(f"not within {seconds} s: {self.describe()}")

    def start(self, body: str, name: str = "test") -> None:
        self.controller.run_script(f"def {name}():\n{body}\nend\n")
        self.messages += self.controller.take_messages()

    def run(self, body: str, seconds: float = 30.0) -> int:
        """Run a program to its end; returns the periods in which it was PLAYING."""
        self.start(body)
        playing = self.until(lambda: self.controller.runtime_state != RuntimeState.PLAYING, seconds)
        self.until(lambda: self.controller.runtime_state == RuntimeState.STOPPED, seconds)
        return playing

    def write(self, **inputs: Any) -> None:
        self.controller.write_inputs(inputs)

    def of_type(self, kind: type) -> list[Any]:
        return [message for message in self.messages if isinstance(message, kind)]

    def describe(self) -> Mapping[str, Any]:
        c = self.controller
        return {
            "robot": c.robot_mode.name,
            "safety": c.safety_mode.name,
            "runtime": c.runtime_state.name,
            "last messages": self.messages[-5:],
        }


def apart(a: Any, b: Any) -> float:
    """Largest difference between two vectors."""
    return max(abs(x - y) for x, y in zip(a, b, strict=True))
