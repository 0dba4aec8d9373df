"""The simulated gripper: fingers, what lies between them, and the commands that move them. In mm, mm/s, N."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from crtk_sim_backends.defects import JointDefects, Sense, read_defects
from crtk_sim_backends.kit import Fault
from crtk_sim_backends.kit.jaw import Jaw, Met
from crtk_sim_backends.weiss_wsg import models
from crtk_sim_backends.weiss_wsg.config import SimConfig
from crtk_sim_backends.weiss_wsg.models import FLAGS, KINDS, MODELS

Answer = Callable[..., None]
"""Takes a status code and values; twice for a motion."""

STATES: Final[Mapping[str, int]] = {
    "HOME": models.POSITIONING,
    "MOVE": models.POSITIONING,
    "GRIP": models.GRASPING,
    "RELEASE": models.RELEASING,
}
"""What the grasping state is during a motion."""
GRIPPED: Final = (models.HOLDING, models.NO_PART, models.PART_LOST)
"""In which it can release."""


@dataclass
class Task:
    """A motion; `part` is the width of the part that is gripped for, None for any."""

    name: str
    goal: float
    speed: float
    answer: Answer
    part: float | None = None


class Gripper:
    """One gripper."""

    kinds = KINDS

    def __init__(self, config: SimConfig) -> None:
        self.config = config
        self.model = MODELS[config.model]
        self.jaw = Jaw(config.opening, config.part_width, config.part_stiffness)
        self.speed = self.force = 0.0
        self.grasping = models.IDLE
        self.referenced, self.fast = config.referenced, False
        self.force_limit, self.acceleration = self.model.force[1], 500.0
        self.soft_limits = (0.0, self.model.stroke)
        self.travel = 1e3 * config.clamping_travel
        self.task: Task | None = None
        self.faults: dict[str, Mapping[str, Any]] = {}
        self.motions = 0
        self._flags = 0  # that outlast a motion
        self._forced = 0
        self._gripped = 0.0
        self._now = 0.0
        defects = read_defects(JointDefects, config.defects)
        self._sense = Sense(defects[0], 0) if defects else None
        self.cut: Callable[[], None] = lambda: None  # ends all connections

    # ---------------------------------------------------------------------------------- its commands

    def obey(self, name: str, values: Sequence[float], answer: Answer) -> None:
        """Carry out a command, or begin to."""
        status = self._refusal(name, values)
        if status != models.OK:
            answer(status)
        elif name in STATES:
            self._begin(name, values, answer)
        else:
            answer(models.OK, *getattr(self, f"_{name.lower()}")(*values))

    def _refusal(self, name: str, values: Sequence[float]) -> int:
        if not all(map(math.isfinite, values)):
            return models.PARAMETER
        if name not in STATES:
            return models.OK
        if self.fast:
            return models.DENIED
        if name != "HOME" and not self.referenced:
            return models.NOT_REFERENCED
        if name == "RELEASE" and self.grasping not in GRIPPED:
            return models.DENIED
        if name in ("MOVE", "GRIP") and self.grasping == models.HOLDING:
            return models.DENIED
        return models.RUNNING if self.task and self.config.while_moving == "refuse" else models.OK

    def _begin(self, name: str, values: Sequence[float], answer: Answer) -> None:
        self._end(models.ABORTED, models.IDLE)
        self.motions += 1
        self._flags = 0
        low, high = self.soft_limits
        homes = 1e3 * self.config.homing_speed
        speed = homes if name == "HOME" else self._within(values[1], self.model.speed)
        part = None  # any
        if name == "HOME":
            goal = 0.0 if values[0] == 2 else self.model.stroke
        elif name == "GRIP":
            part = values[0] if values[0] >= 0.0 else None
            goal = 0.0 if part is None else max(0.0, part - self.travel)
        else:
            goal = self._within(values[0], (low, high))
            if goal != values[0]:
                self._flags = 1 << FLAGS["soft_limit_plus" if goal == high else "soft_limit_minus"]
        self.task, self.grasping = Task(name, goal, speed, answer, part), STATES[name]
        answer(models.PENDING)

    @staticmethod
    def _within(value: float, limits: tuple[float, float]) -> float:
        return min(max(value, limits[0]), limits[1])

    def _end(self, status: int, grasping: int) -> None:
        task, self.task = self.task, None
        if task is not None:
            self.grasping = grasping
            given = self.faults.get("fail", {})
            fails = given and given["command"] in ("", task.name)
            task.answer(given["status"] if fails and status != models.ABORTED else status)

    def _stop(self) -> tuple[float, ...]:
        self._end(models.ABORTED, models.IDLE)
        self.grasping, self.force = models.IDLE, 0.0  # and lets go of what it holds
        self._flags = 1 << FLAGS["axis_stopped"]
        return ()

    def _faststop(self) -> tuple[float, ...]:
        self._end(models.ABORTED, models.ERROR)
        self.fast, self.grasping = True, models.ERROR
        return ()

    def _fsack(self) -> tuple[float, ...]:
        if self.fast and not any(self.told_flags >> FLAGS[name] & 1 for name in models.STOPPING):
            self.fast, self.grasping = False, models.IDLE
        return ()

    def _setacc(self, value: float) -> tuple[float, ...]:
        self.acceleration = self._within(value, self.model.acceleration)
        return ()

    def _getacc(self) -> tuple[float, ...]:
        return (self.acceleration,)

    def _setforce(self, value: float) -> tuple[float, ...]:
        self.force_limit = self._within(value, (self.model.force[0], self.model.force[1]))
        return ()

    def _getforce(self) -> tuple[float, ...]:
        return (self.force_limit,)

    def _setlimits(self, low: float, high: float) -> tuple[float, ...]:
        self.soft_limits = max(0.0, low), min(self.model.stroke, high)
        return ()

    def _getlimits(self) -> tuple[float, ...]:
        return self.soft_limits

    def _clearlimits(self) -> tuple[float, ...]:
        self.soft_limits = 0.0, self.model.stroke
        return ()

    # ------------------------------------------------------------------------------- its mechanics

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self._now += seconds
        before = self.width
        if self.task is not None:
            self._move(self.task, seconds)
        elif self.grasping == models.HOLDING:
            self._hold(seconds)
        self.speed = (self.width - before) / seconds

    @property
    def width(self) -> float:
        """The opening, in mm."""
        return 1e3 * self.jaw.opening

    def _move(self, task: Task, seconds: float) -> None:
        met = self.jaw.follow(1e-3 * task.goal, 1e-3 * task.speed, self.force_limit, seconds)
        is_blocked = met is Met.OBJECT
        self.force = self.force_limit if is_blocked else 0.0
        if met is Met.NOTHING:
            return
        if task.name == "GRIP":
            self._grip(task, is_blocked)
        elif is_blocked:
            self._flags |= 1 << FLAGS["blocked_minus"]
            self._end(models.BLOCKED, models.IDLE)
        else:
            self.referenced |= task.name == "HOME"
            self._flags |= 1 << FLAGS["target_reached"]
            self._end(models.OK, models.IDLE)

    def _grip(self, task: Task, is_blocked: bool) -> None:
        if not is_blocked:
            self._end(models.FAILED, models.NO_PART)
        elif task.part is not None and self.width > task.part + self.travel:
            self._end(models.BLOCKED, models.ERROR)
        else:
            self._gripped = self.width
            self._end(models.OK, models.HOLDING)

    def _hold(self, seconds: float) -> None:
        self.jaw.slip(seconds)
        least = 1e-3 * max(0.0, self._gripped - self.travel)
        if self.jaw.follow(least, 1.0, self.force_limit, seconds) is Met.GOAL:
            self.grasping, self.force = models.PART_LOST, 0.0

    # ------------------------------------------------------------------------------ what it tells

    @property
    def told_flags(self) -> int:
        """The system state."""
        own = {
            "referenced": self.referenced,
            "moving": self.task is not None,
            "fast_stop": self.fast,
        }
        return self._flags | self._forced | sum(1 << FLAGS[name] for name, on in own.items() if on)

    @property
    def told_grasping(self) -> int:
        """The grasping state."""
        forced = self.faults.get("grasping")
        return self.grasping if forced is None else int(forced["state"])

    @property
    def told_motion(self) -> tuple[float, float, float]:
        """Width, speed and force."""
        if self._sense is None:
            return self.width, self.speed, self.force
        position, speed, force = self._sense.tell(
            self.width / 1e3, self.speed / 1e3, self.force, self._now
        )
        return 1e3 * position, 1e3 * speed, force

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {
            **self.jaw.status,
            "force": self.force,
            "force_limit": self.force_limit,
            "acceleration": self.acceleration / 1e3,
            "soft_limits": [limit / 1e3 for limit in self.soft_limits],
            "grasping": self.told_grasping,
            "flags": self.told_flags,
            "referenced": self.referenced,
            "fast_stop": self.fast,
            "moves": self.task is not None,
            "motions": self.motions,
        }

    # --------------------------------------------------------------------------------- its faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        given = self.faults[fault.kind] = fault.parameters
        if self.jaw.begin(fault):
            return
        if fault.kind == "flag":
            self._forced |= 1 << FLAGS[given["name"]]
            if given["name"] in models.STOPPING:
                self._faststop()
        elif fault.kind == "fast_stop":
            self._faststop()
        elif fault.kind == "unpowered":
            self.cut()
            self._end(models.ABORTED, models.IDLE)
            self.referenced, self.fast, self.grasping = False, False, models.IDLE
        elif fault.kind == "as_new":
            self._begin("HOME", (0.0,), lambda *_: None)
            self._end(models.ABORTED, models.IDLE)
            self.jaw.opening, self.referenced, self.fast = given["opening"], True, False
        elif fault.kind == "other_program":
            self._begin("MOVE", (1e3 * given["opening"], 10.0), lambda *_: None)

    def end(self, fault: Fault) -> None:
        """Let it end."""
        given = self.faults.pop(fault.kind, fault.parameters)
        if not self.jaw.end(fault) and fault.kind == "flag":
            self._forced &= ~(1 << FLAGS[given["name"]])
