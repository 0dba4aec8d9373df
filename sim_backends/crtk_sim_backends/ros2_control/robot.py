"""A simulated robot behind ros2_control: joints, one hardware component, and what controls them.

It knows neither ROS nor a clock: `advance` lets time pass, and the manager's services are methods.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from crtk_sim_backends.faults import Fault, KindTable
from crtk_sim_backends.ros2_control.controllers import (
    BROADCASTER,
    Controller,
    ForwardController,
    TrajectoryController,
)
from crtk_sim_backends.ros2_control.injection import KINDS
from crtk_sim_backends.ros2_control.joints import JointLimits, Joints, Vector

BEST_EFFORT: Final = 1
STRICT: Final = 2
HARDWARE: Final = "sim_system"
START: Final = (0.0, 0.4, 0.8, 0.2, 0.6, 0.0)
"""Where the joints begin, rad."""
OTHERS: Final = "admittance_controller"
"""A controller that belongs to somebody else."""


class Robot:
    """One robot.

    Args:
        limits: of its joints.
        keeps: see `ForwardController`.

    Attributes:
        now: seconds since the start.
        joints: the mechanics.
        controllers: loaded ones, by name.
        hardware: state of its hardware component.
        faults: that go on now, with their parameters, by kind.
        away_until: when the restarted node is back.
    """

    def __init__(self, limits: tuple[JointLimits, ...], keeps: bool) -> None:
        self.limits = limits
        self._keeps = keeps
        self.now = 0.0
        self.joints = Joints(limits, np.resize(START, len(limits)))
        self.hardware = "active"
        self.faults: dict[str, Mapping[str, Any]] = {}
        self.away_until = -1.0
        self._unloaded: dict[str, Controller] = {}
        self.controllers: dict[str, Controller] = {}
        self._load()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the joints."""
        return tuple(limit.name for limit in self.limits)

    def _load(self) -> None:
        order = list(range(len(self.limits)))
        if "other_order" in self.faults:
            order.reverse()
        found: list[Controller] = [
            Controller("joint_state_broadcaster", BROADCASTER, "", order),
            *(
                ForwardController(f"forward_{kind}_controller", kind, order, self._keeps)
                for kind in ("position", "velocity", "effort")
            ),
            TrajectoryController("joint_trajectory_controller", order),
            Controller(OTHERS, "admittance_controller/AdmittanceController", "position", order),
        ]
        self.controllers = {one.name: one for one in found}
        self.controllers["joint_state_broadcaster"].state = "active"
        self.joints.use("")

    # -------------------------------------------------------------------------------------- time

    def advance(self, seconds: float) -> None:
        """Let time pass: controllers, then joints."""
        self.now += seconds
        if self.hardware == "active":
            for controller in self.controllers.values():
                if controller.state == "active" and controller.interface:
                    command = controller.update(self.now, self.joints.position)
                    if command is not None:
                        self.joints.command = command
        self.joints.blocked = {self.faults["block"]["joint"]} if "block" in self.faults else set()
        self.joints.advance(seconds)

    @property
    def is_silent(self) -> bool:
        """Whether nothing of it is told, heard or answered."""
        return "disconnect" in self.faults or self.now < self.away_until

    @property
    def broadcasts(self) -> bool:
        """Whether joint states are published."""
        broadcaster = self.controllers.get("joint_state_broadcaster")
        is_active = broadcaster is not None and broadcaster.state == "active"
        return is_active and not self.is_silent and "broadcaster_stops" not in self.faults

    def place(self, positions: Sequence[float]) -> None:
        """Put the joints somewhere, as a hand does while nothing holds them."""
        self.joints.position = np.array(positions, dtype=float)
        self.joints.velocity = np.zeros(len(self.limits))
        if not self.joints.kind:
            self.joints.command = self.joints.position.copy()

    # ----------------------------------------------------------------------- the manager's services

    def claimed(self, controller: Controller) -> list[str]:
        """Return the interfaces that a controller needs, ``joint/kind``."""
        if not controller.interface:
            return []
        return [f"{self.names[place]}/{controller.interface}" for place in controller.order]

    def switch(
        self, activate: Sequence[str], deactivate: Sequence[str], strictness: int
    ) -> tuple[bool, str]:
        """Activate and deactivate; return whether that went well, and what is said of it."""
        is_strict = strictness != BEST_EFFORT
        on: list[Controller] = []
        off: list[Controller] = []
        why = ""
        for names, state, kept in ((deactivate, "active", off), (activate, "inactive", on)):
            for name in names:
                wrong = self._wrong(name, state)
                if wrong and is_strict:
                    return False, wrong
                why = wrong or why
                if not wrong:
                    kept.append(self.controllers[name])
        remaining = [
            one for one in self.controllers.values() if one.state == "active" and one not in off
        ]
        for one in tuple(on):
            clash = self._clash(one, [*remaining, *(other for other in on if other is not one)])
            if clash and is_strict:
                return False, clash
            if clash:
                why = clash
                on.remove(one)
        for one in off:
            one.state = "inactive"
            one.deactivated()
        refused = self._refused(on)
        if refused and is_strict:
            self._follow_claims()
            return False, f"{refused} failed to activate"
        feigned = self.faults.get("feign_activation", {}).get("controller")
        for one in on:
            if one.name not in (refused, feigned):
                one.state = "active"
                one.activated(self.joints.position)
        self._follow_claims()
        return not (why and not on and not off), why

    def _wrong(self, name: str, state: str) -> str:
        if name not in self.controllers:
            return f"Could not find controller '{name}'"
        if self.controllers[name].state != state:
            return f"Controller '{name}' is {self.controllers[name].state}, not {state}"
        if state == "inactive" and self.controllers[name].interface and self.hardware != "active":
            return f"Command interfaces of '{name}' are not available: hardware is {self.hardware}"
        return ""

    def _clash(self, one: Controller, others: Sequence[Controller]) -> str:
        for other in others:
            if one.interface and other.interface and set(one.order) & set(other.order):
                return (
                    f"Resource conflict between '{one.name}' and '{other.name}', which commands "
                    f"{other.interface} of the same joints"
                )
        return ""

    def _refused(self, on: Sequence[Controller]) -> str:
        name = self.faults.get("refuse_activation", {}).get("controller")
        return name if name in [one.name for one in on] else ""

    def _follow_claims(self) -> None:
        """Let the joints follow the kind of command of whoever is active; they hold if nobody is."""
        kinds = [one.interface for one in self.controllers.values() if one.state == "active"]
        self.joints.use(next(filter(None, kinds), ""))

    def set_hardware(self, name: str, state: str) -> tuple[bool, str]:
        """Bring the hardware into a state; return whether it did, and where it is."""
        if name != HARDWARE:
            return False, "unknown"
        if self.hardware == "finalized" and state != "finalized":
            return False, self.hardware
        self._leave_for(state)
        return True, self.hardware

    def _leave_for(self, state: str) -> None:
        self.hardware = state
        if state == "active":
            return
        self.joints.use("")
        self.joints.command = self.joints.position.copy()
        for one in self.controllers.values():
            if one.state == "active" and (one.interface or state != "inactive"):
                one.state = "inactive"
                one.deactivated()

    def forward(self, name: str, values: Sequence[float]) -> None:
        """A command for a forward controller came."""
        one = self.controllers.get(name)
        if isinstance(one, ForwardController) and "deaf" not in self.faults and not self.is_silent:
            one.hear(values)

    # -------------------------------------------------------------------------------------- faults

    @property
    def kinds(self) -> KindTable:
        """See `crtk_sim_backends.kit.Device`."""
        return KINDS

    def begin(self, fault: Fault) -> None:
        """See `crtk_sim_backends.kit.Device`."""
        given = fault.parameters
        if KINDS[fault.kind].lasting:
            self.faults[fault.kind] = given
            if fault.kind == "other_order":
                self._load()
            return
        name = given.get("controller", "")
        if fault.kind == "hardware_error":
            self._leave_for(given["to"])
        elif fault.kind == "hardware_mended":
            self.hardware = "active"
            self.controllers["joint_state_broadcaster"].state = "active"
        elif fault.kind == "deactivate":
            self.switch([], [name], BEST_EFFORT)
        elif fault.kind == "all_inactive":
            ours = [one.name for one in self.controllers.values() if one.interface]
            self.switch([], ours, BEST_EFFORT)
        elif fault.kind == "take_joints":
            ours = [one.name for one in self.controllers.values() if one.interface]
            self.switch([OTHERS], ours, BEST_EFFORT)
        elif fault.kind == "give_joints":
            self.switch([], [OTHERS], BEST_EFFORT)
        elif fault.kind == "unload" and name in self.controllers:
            self.switch([], [name], BEST_EFFORT)
            self._unloaded[name] = self.controllers.pop(name)
        elif fault.kind == "load" and name in self._unloaded:
            self.controllers[name] = self._unloaded.pop(name)
        elif fault.kind == "restart":
            self.away_until = self.now + given["seconds"]
            self.hardware = "active"
            for one in self.controllers.values():
                if one.state == "active":
                    one.deactivated()
            self._load()

    def end(self, fault: Fault) -> None:
        """See `crtk_sim_backends.kit.Device`."""
        self.faults.pop(fault.kind, None)
        if fault.kind == "other_order":
            self._load()

    def status(self) -> Mapping[str, Any]:
        """See `crtk_sim_backends.kit.Device`."""
        active = [one.name for one in self.controllers.values() if one.state == "active"]
        forward = [one for one in self.controllers.values() if isinstance(one, ForwardController)]
        return {
            "active": active,
            "hardware": self.hardware,
            "follows": self.joints.kind or "nothing",
            "positions": _rounded(self.joints.position),
            "velocities": _rounded(self.joints.velocity),
            "command": _rounded(self.joints.command),
            "ignored": sum(one.ignored for one in forward),
        }

    def told_limits(self) -> list[dict[str, Any]]:
        """What its joints are called, and their limits."""
        return [asdict(limit) for limit in self.limits]


def _rounded(values: Vector) -> list[float]:
    return [round(value, 6) for value in values.tolist()]
