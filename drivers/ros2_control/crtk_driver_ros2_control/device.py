"""A robot behind ros2_control as a CRTK device.

Joint states come in; commands go to one controller at a time, that of the mode. Which one is active, and
whether the hardware is, the controller manager is asked again and again; it alone changes that.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from typing_extensions import override

from crtk_driver_ros2_control.arm import load_arm
from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_driver_ros2_control.controllers import FORWARD, UNTIMED, Role, roles_of, ways_of
from crtk_driver_ros2_control.foreign.node import ForeignNode
from crtk_driver_ros2_control.joint_states import JointStates, Measured
from crtk_driver_ros2_control.motion import KNOWN, Motion
from crtk_driver_ros2_control.outgoing import Outgoing
from crtk_driver_ros2_control.supervision import Supervision
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    Following,
    Goal,
    Kinematics,
    MoveProgress,
    Note,
    Setpoint,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import (
    ConfigError,
    ConnectionFailed,
    ConnectionLost,
    CrtkError,
    TransitionFailed,
    raise_first,
)
from crtk_drivers.recording import cdr
from crtk_drivers.samples import JointState, Sample, Stamp, Twist, Value, vector

logger = logging.getLogger(__name__)

FURTHEST: Final = 0.35
"""rad (m) that a joint may be from where it was sent, and from which on it does not follow."""
ARRIVAL: Final = 0.01
"""rad (m) within which a joint is where a move ends."""
PAUSE: Final = 0.01
"""Seconds between two looks while `open` waits."""
BRAKED: Final = 0.5
"""Share of the time of a stop in which what is sent is at rest: the joints follow later."""
CLOSING: Final = 2.0
"""Seconds that the node on the robot's side may take to end, besides the time of a stop."""
RIVAL: Final = 5.0
"""Seconds for which another sender of joint states is remembered."""
JOINT_STATE: Final = cdr.TYPE_NAMES[JointState]

_KEEPS: Final = {
    Role.POSITION: "positions: they go to the last setpoint and hold it",
    Role.VELOCITY: "velocities: they GO ON at the last velocity",
    Role.EFFORT: "efforts: they KEEP the last effort",
    Role.TRAJECTORY: "trajectories: they end at their last point and hold it",
}
_FOR_EVER: Final = 1e9
"""Seconds: no controller of ours has a timeout."""


@dataclass
class _Connection:
    """What there is while the robot is connected."""

    node: Any
    supervision: Supervision


class Ros2ControlDevice(Device):
    """One robot.

    Args:
        config: of it.

    Raises:
        ConfigError: it has no joints or no controllers, or its URDF cannot be used.
    """

    def __init__(self, config: Ros2ControlConfig) -> None:
        self._config = config
        self._arm = arm = load_arm(config)
        self._roles = roles_of(config)
        if not self._roles:
            raise ConfigError(
                "there is no controller that commands could go to",
                where="ros2-control",
                remedy="Name one: --position-controller forward_position_controller; "
                "`crtk-driver ros2-control describe` shows those of the robot.",
            )
        self._ways = ways_of(self._roles)
        self._kinematics = self._chain()
        self._period = 1.0 / config.rate
        fastest = vector([limit.velocity for limit in arm.limits])
        acceleration = vector([limit.acceleration for limit in arm.limits])
        self._outgoing = Outgoing(
            self._roles,
            arm.joints,
            fastest,
            vector(np.maximum(acceleration, fastest / (BRAKED * config.stop_time))),
            self._period,
        )
        self._capabilities = self._declared()
        self._states = JointStates(arm.joints)
        self._arrived = threading.Condition()
        self._newest: Measured | None = None
        self._taken: Measured | None = None
        self._is_woken = False
        self._aborted = threading.Event()
        self._connection: _Connection | None = None
        self._late = 0.0
        self._rival_name = ""
        self._motion = Motion(
            config, arm, self._roles, self._outgoing, lambda: self._taken, self.address
        )

    def _chain(self) -> Kinematics | None:
        if self._arm.chain is None:
            return None
        from crtk_drivers.kinematics.serial import SerialChain

        tool = self._config.tool
        return SerialChain(
            self._arm.chain,
            tool=None if tool is None else tool.pose,
            frame_id=self._config.base_link,
            name=self.address,
        )

    def _declared(self) -> Capabilities:
        config, arm = self._config, self._arm
        has_tool = self._kinematics is not None
        count = len(arm.joints)
        native = {"move_jp"} if config.moves_by_goal else set()
        keeps = "; ".join(_KEEPS[role] for role in self._roles)
        holds = not UNTIMED & set(self._roles)
        return Capabilities(
            joints=arm.joints,
            limits=arm.limits,
            cartesian_limits=arm.tool,
            modes=frozenset(self._ways),
            measured=("measured_js", "measured_cp", "measured_cv")
            if has_tool
            else ("measured_js",),
            native_moves=frozenset(native),
            stops_between_modes=True,
            rate=config.rate,
            paced_by_stream=True,
            base_frame=config.base_link if has_tool else "base",
            tool_frame=config.tip_link if has_tool else "tool",
            transition_timeout=6.0 * config.service_timeout,
            stop=StopPolicy(
                config.stop_time if holds else _FOR_EVER,
                "slows down and holds. Controllers of ros2_control have no timeout: when this process is "
                f"killed, the joints keep what they were told last ({keeps})",
                config.stop_time,
            ),
            following=Following((FURTHEST,) * count, (ARRIVAL,) * count, config.lag),
        )

    # ------------------------------------------------------------------------------------ description

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        domain = self._config.domain
        return self._config.controller_manager + ("" if domain is None else f" domain {domain}")

    @property
    @override
    def bus(self) -> str:
        """One of its own: several robots behind one manager have joint states of their own."""
        return f"{self.address} {self._arm.joints[0]}"

    @property
    @override
    def kinematics(self) -> Kinematics | None:
        return self._kinematics

    @property
    @override
    def found(self) -> str:
        connection = self._connection
        if connection is None:
            return ""
        active = [name for name in self._roles.values() if connection.supervision.is_active(name)]
        return f"{', '.join(active)} is active" if active else ""

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        """Messages of joint_states that were not used, commands, switches, questions without answer."""
        connection = self._connection
        unanswered = 0 if connection is None else connection.supervision.unanswered
        return {
            **{f"joint states {kind}": count for kind, count in tuple(self._states.counts.items())},
            "commands": self._outgoing.sent,
            "switches": self._motion.switches,
            "questions unanswered": unanswered,
            "age of the joint state (s)": self._late,
        }

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        found = []
        rival = self._rival()
        connection = self._connection
        others = () if connection is None else connection.node.others
        if others:
            text = f"{', '.join(others)} can command our controllers, too"
            found.append(Note(Severity.WARNING, "commands", text))
        if rival:
            found.append(Note(Severity.WARNING, "joint states", rival))
        role = self._motion.role
        if role is not None:
            found.append(Note(Severity.INFO, "controller", self._roles[role]))
        return tuple(found)

    def _rival(self) -> str:
        rival = self._states.rival
        if rival is None or time.monotonic() - rival[1] > RIVAL:
            return ""
        topic = self._config.joint_states
        return f"{self._rival_name} tells of our joints too, on {topic}; it is not listened to"

    # ------------------------------------------------------------------------------------- connection

    @override
    def open(self, deadline: float) -> None:
        config = self._config
        self._forget()
        node = ForeignNode(
            namespace=config.controller_manager.rpartition("/")[0] + "/",
            joint_states=config.joint_states,
            forward=[name for role, name in self._roles.items() if role in FORWARD],
            trajectory=self._roles.get(Role.TRAJECTORY, ""),
            domain=config.domain,
            heard=self._hear,
            pump=self._outgoing.pump,
            ending=config.stop_time,
        )
        supervision = Supervision(config, self._roles, self._arm.joints, node)
        node.asks = supervision.asks
        self._connection = _Connection(node, supervision)
        self._motion.connect(node, supervision)
        node.start()
        self._outgoing.wire = node
        try:
            self._outgoing.orders = self._waited(supervision, deadline)
        except CrtkError as error:
            self.close()
            raise ConnectionFailed(
                error.message, where=self.address, remedy=error.remedy
            ) from error
        self._outgoing.stop()  # what the connection before left going

    def _waited(self, supervision: Supervision, deadline: float) -> dict[Role, Any]:
        """Wait for the controllers, their joints, and the first joint state."""
        why: CrtkError = ConnectionFailed("there is no time", where=self.address)
        while time.monotonic() < deadline and not self._aborted.is_set():
            try:
                found: dict[Role, Any] = self._run(self._greeting(supervision, deadline), deadline)
            except TransitionFailed as error:
                why = error
                self._aborted.wait(PAUSE)
            else:
                return found
        raise why

    def _greeting(
        self, supervision: Supervision, deadline: float
    ) -> Generator[None, None, dict[Role, Any]]:
        listed = yield from supervision.listed()
        wrong = supervision.check(listed)
        if wrong:
            raise TransitionFailed(
                wrong,
                where=self.address,
                remedy="`crtk-driver ros2-control describe` shows what the robot has.",
            )
        orders = yield from supervision.orders()
        while self._newest is None:
            if time.monotonic() > deadline - 5.0 * PAUSE:
                raise TransitionFailed(
                    self._nothing(),
                    where=self._config.joint_states,
                    remedy="Is joint_state_broadcaster active, and are the joints called as in the "
                    "configuration?",
                )
            yield
        return orders

    def _nothing(self) -> str:
        trouble = self._states.trouble
        return f"joint states cannot be used: {trouble}" if trouble else "no joint states come"

    def _run(self, steps: Generator[None, None, Any], deadline: float) -> Any:
        while time.monotonic() < deadline:
            if self._aborted.is_set():
                raise ConnectionFailed("it is being closed", where=self.address)
            self._check_node()
            try:
                next(steps)
            except StopIteration as end:
                return end.value
            self._aborted.wait(PAUSE)
        raise TransitionFailed(
            f"there is no answer from {self.address}",
            where=self.address,
            remedy="Is ros2_control_node running, in this ROS domain and range?",
        )

    @override
    def abort_open(self) -> None:
        self._aborted.set()

    @override
    def wake(self) -> bool:
        with self._arrived:
            self._is_woken = True
            self._arrived.notify_all()
        return True

    @override
    def close(self) -> None:
        """Leave the controllers as they are: they hold what `stop` sent last."""
        connection, self._connection = self._connection, None
        if connection is None:
            return
        self._motion.disconnect()
        timeout = CLOSING + self._config.stop_time
        if not connection.node.stop(timeout):
            logger.warning("%s: its node did not end in %g s", self.address, timeout)
        self._outgoing.wire = None

    def _forget(self) -> None:
        self._states = JointStates(self._arm.joints, self._states.lasting_ages)
        self._newest = self._taken = None

    def _hear(self, data: bytes, sender: Any) -> None:
        """A message of joint_states came. In the node's thread."""
        arrival = time.monotonic()
        try:
            found = cdr.decode(JOINT_STATE, data)
        except ValueError as error:
            self._states.not_read(str(error))
            return
        assert isinstance(found.value, JointState)
        # By its id, which stays when this driver connects again.
        measured = self._states.take(found.value, found.stamp_ns, sender.gid, arrival)
        if self._states.rival == (sender.gid, arrival):
            # In this thread, which may ask the graph: that may know the name a while after the messages come.
            self._rival_name = sender.name
        if measured is not None:
            with self._arrived:
                self._newest = measured
                self._arrived.notify_all()

    @override
    def read(self, deadline: float) -> Sample | None:
        """Return the newest joint state; look after controllers and what they are being switched to."""
        measured = self._await(deadline)
        now = time.monotonic()
        self._check_node()
        assert self._connection is not None
        self._connection.supervision.look(now)
        self._motion.step()
        if measured is None:
            self._check_silence(now)
            return None
        self._motion.settle(measured)
        self._late = now - measured.acquired
        return Sample(Stamp.at(measured.acquired), self._values(measured.state))

    def _await(self, deadline: float) -> Measured | None:
        with self._arrived:
            while self._newest is self._taken and not self._is_woken:
                left = deadline - time.monotonic()
                if left <= 0.0:
                    break
                self._arrived.wait(left)
            self._is_woken = False
            if self._newest is self._taken:
                return None
            self._taken = self._newest
            return self._taken

    def _values(self, state: JointState) -> Mapping[str, Value]:
        values: dict[str, Value] = {"measured_js": state}
        if self._kinematics is not None:
            values["measured_cp"] = self._kinematics.forward(state.position)
            if state.velocity.size:
                twist = self._kinematics.jacobian(state.position) @ state.velocity
            else:
                twist = np.zeros(6)
            frame = self._capabilities.base_frame
            values["measured_cv"] = Twist(vector(twist[:3]), vector(twist[3:]), frame)
        return values

    def _check_node(self) -> None:
        node = None if self._connection is None else self._connection.node
        if node is None or not node.is_running:
            why = "it is not connected" if node is None else node.failure or "its node ended"
            raise ConnectionLost(why, where=self.address)

    def _check_silence(self, now: float) -> None:
        """Say why there are no samples, where more is known than that."""
        taken = self._taken
        patience = KNOWN * self._config.sample_timeout
        silent = taken is not None and now - taken.arrived > patience
        if silent and self._states.trouble:
            raise ConnectionLost(
                self._nothing(),
                where=self._config.joint_states,
                remedy="Look at what publishes it: ros2 topic echo, ros2 topic info -v.",
            )

    # ----------------------------------------------------------------------------------------- motion

    @property
    @override
    def condition(self) -> Condition:
        return self._motion.condition

    @override
    def write(self, setpoint: Setpoint) -> None:
        self._motion.follow(setpoint)

    @override
    def move(self, goal: Goal) -> None:
        self._motion.move(goal)

    @override
    def move_progress(self) -> MoveProgress:
        return self._motion.progress()

    @override
    def stop(self) -> None:
        self._motion.stop()

    @property
    @override
    def has_stopped(self) -> bool:
        return self._motion.has_stopped

    @property
    @override
    def takes_setpoints(self) -> bool:
        return self._motion.takes_setpoints

    @property
    @override
    def pace(self) -> float:
        return self._motion.pace

    @override
    def enable(self) -> Steps:
        """Hardware active, then the controller that holds; see `Motion.enable`.

        Raises:
            TransitionFailed, DeviceFault: what is in the way.
        """
        raise_first(self._of_rival())
        yield from self._motion.enable()

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        if self._connection is None:
            return ()
        return (*self._of_rival(), *self._motion.obstacles())

    def _of_rival(self) -> Iterator[TransitionFailed]:
        rival = self._rival()
        if rival:
            yield TransitionFailed(
                rival,
                where=self._config.joint_states,
                remedy="Stop one of the two, or let it publish on another topic.",
            )

    @override
    def disable(self) -> Steps:
        yield from self._motion.disable()
