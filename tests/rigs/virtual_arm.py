"""A virtual arm behind an engine, on a clock that the test turns, and what its samples show."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from crtk_driver_virtual.config import VirtualConfig
from crtk_driver_virtual.defective_device import DefectiveDevice
from crtk_driver_virtual.defects_config import DefectsConfig
from crtk_driver_virtual.device import VirtualDevice
from crtk_drivers.engine import Engine
from crtk_drivers.samples import JointState, Pose, Sample, Vector, vector
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.clock import FakeClock

RATE = 500.0
PERIOD = 1.0 / RATE
JOINT = 1
"""The joint that is moved: it carries weight, and the tool with it."""
FREQUENCY, AMPLITUDE = 2.0, 0.03
"""Hz and rad of the sine that it follows."""


class Bench:
    """An arm behind an engine, and all samples that it gave."""

    def __init__(self, defects: dict[str, Any], **keys: Any) -> None:
        self.clock = FakeClock()
        config = VirtualConfig(transition_time=0.01, defects=DefectsConfig(**defects), **keys)
        self.device = (
            DefectiveDevice(config, self.clock.stamp, self.clock.advance)
            if defects
            else VirtualDevice(config, self.clock.stamp)
        )
        self.engine = Engine(self.device, "arm", None, self.clock, self.clock.advance)
        self.samples: list[Sample] = []
        self.came: list[float] = []
        self.stream_began = 0.0
        read = self.device.read

        def seen(deadline: float) -> Sample | None:
            sample = read(deadline)
            if sample is not None:
                self.samples.append(sample)
                self.came.append(self.clock())
            return sample

        self.device.read = seen  # type: ignore[method-assign]
        self.engine.connect(self.clock() + 1.0)
        self.run(0.02)

    @property
    def plant(self) -> Any:
        return self.device.plant

    @property
    def state(self) -> OperatingState:
        return self.engine.status.state

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> list[Sample]:
        """Go on, and return the samples that came."""
        begin = len(self.samples)
        end = self.clock() + seconds - 0.5 * PERIOD
        while self.clock() < end:
            self.clock.advance(PERIOD)
            each()
            self.engine.cycle(self.clock() + PERIOD)
        return self.samples[begin:]

    def command(self, name: str) -> None:
        self.engine.state_command(name)
        for _ in range(2000):
            if self.engine.transition_ended and self.state is not OperatingState.FAULT:
                return
            self.run(PERIOD)
        raise AssertionError(f"{name} did not end")

    def enabled(self) -> "Bench":
        self.command("enable")
        return self

    def go(self, way: float, joint: int = JOINT, wait: float = 0.3) -> list[Sample]:
        """Move a joint, and stay there for a while."""
        here = self.setpoint.copy()
        here[joint] += way
        begin = len(self.samples)
        move = self.engine.submit("move_jp", JointState(vector(here)))
        assert move is not None
        self.run(0.01)
        while move.is_busy():
            self.run(0.01)
        self.run(wait)
        return self.samples[begin:]

    def stream(self, way: Callable[[float], float], seconds: float) -> list[Sample]:
        """Send `way(t)` for the joint, from where it is, in each cycle."""
        self.stream_began = begin = self.clock()
        start = self.setpoint.copy()

        def send() -> None:
            goal = start.copy()
            goal[JOINT] += way(self.clock() - begin)
            self.engine.submit("servo_jp", JointState(vector(goal)))

        return self.run(seconds, send)

    @property
    def setpoint(self) -> Vector:
        found = self.engine.feedback("setpoint_js")
        assert found is not None
        assert isinstance(found[0], JointState)
        return found[0].position


def joint_states(samples: list[Sample]) -> list[JointState]:
    found = [sample.values["measured_js"] for sample in samples]
    return [state for state in found if isinstance(state, JointState)]


def column(samples: list[Sample], name: str = "position") -> Vector:
    """What was measured of the joint."""
    return np.array([getattr(state, name)[JOINT] for state in joint_states(samples)])


def times(samples: list[Sample]) -> Vector:
    return np.array([sample.stamp.monotonic for sample in samples])


def tool_points(samples: list[Sample]) -> np.ndarray:
    poses = [sample.values["measured_cp"] for sample in samples]
    return np.array([pose.position for pose in poses if isinstance(pose, Pose)])


def rest(bench: Bench) -> float:
    """Where the joint rests."""
    return float(column(bench.run(0.05)).mean())


def phasor(t: Vector, values: Vector, frequency: float) -> complex:
    """Amplitude and phase at a frequency, by least squares, beside a line."""
    wave = np.exp(2j * math.pi * frequency * t)
    columns = np.column_stack((wave.real, wave.imag, np.ones_like(t), t - t.mean()))
    real, imag, *_ = np.linalg.lstsq(columns, values, rcond=None)[0]
    return complex(real, -imag)


def sine(bench: Bench) -> list[Sample]:
    """The joint follows a sine that begins at rest; a period of it, when it has settled."""

    def way(t: float) -> float:
        return AMPLITUDE * min(1.0, t * FREQUENCY) * math.sin(2.0 * math.pi * FREQUENCY * t)

    return bench.enabled().stream(way, 2.5 / FREQUENCY)[-round(RATE / FREQUENCY) :]


def at_sine(t: Vector, values: Vector) -> complex:
    return phasor(t, values, FREQUENCY)
