"""Joint positions from messages of joint_states, whoever sends them and in whatever order. Pure.

joint_state_broadcaster names its joints in an order of its own, has joints of other devices in its messages,
and NaN where hardware has no such interface. Several nodes may share the topic, each with some joints.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.kit.ages import Ages
from crtk_drivers.samples import JointState, Vector, empty, vector

Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """All joints at one time.

    Attributes:
        state: in the order of the device; without velocities or efforts where one of them is not known.
        acquired: monotonic seconds: by the stamp, and by when messages with stamps have arrived.
        arrived: monotonic seconds.
    """

    state: JointState
    acquired: float
    arrived: float


class JointStates:
    """Collects the joints of one device.

    Args:
        joints: names, in the order of the device.
        ages: by sender, of the connection before: `lasting_ages`. What clocks differ by is not found anew:
            the first message after a silence may be late, and nothing else says so.

    Attributes:
        counts: of messages that were not used, by why.
        problem: why the newest message with a joint of ours was not used; empty if it was.
        rival: who else tells of a joint, and when (monotonic s) that was heard last.
    """

    def __init__(
        self, joints: tuple[str, ...], ages: Mapping[Hashable, Ages] | None = None
    ) -> None:
        self._joints = joints
        self._places = {name: place for place, name in enumerate(joints)}
        count = len(joints)
        self._values = np.full((3, count), np.nan)
        self._stamps = np.zeros(count, dtype=np.int64)
        self._acquired = np.zeros(count)
        self._fresh = np.zeros(count, dtype=bool)
        self._owners: list[Hashable] = [None] * count
        self._orders: dict[tuple[str, ...], tuple[Places, Places]] = {}
        self._ages = dict(ages or {})
        self.counts: Counter[str] = Counter()
        self.problem = ""
        self.rival: tuple[Hashable, float] | None = None

    @property
    def lasting_ages(self) -> dict[Hashable, Ages]:
        """What holds for another connection, too."""
        owners = {*self._owners}
        return {who: ages for who, ages in self._ages.items() if who in owners and ages.lasts}

    def take(
        self, state: JointState, stamp_ns: int, sender: Hashable, arrival: float
    ) -> Measured | None:
        """Take a message; return all joints once each of them is newer than what was returned last.

        Args:
            state: what it holds.
            stamp_ns: of it, on the robot's clock.
            sender: who sent it.
            arrival: monotonic seconds.
        """
        if len(set(state.name)) < len(state.name):
            self._refuse("twice", f"{_twice(state.name)} is there twice")
            return None
        theirs, ours = self._order(state.name)
        if not ours.size:
            self.counts["of other joints"] += 1
            return None
        trouble = self._trouble(state, theirs, ours, stamp_ns)
        if trouble:
            self._refuse(*trouble)
            return None
        if not self._belong_to(ours, sender):
            self.counts["of another sender"] += 1
            self.rival = sender, arrival
            return None
        if (stamp_ns <= self._stamps[ours]).any():
            self._refuse("old", "its stamp does not advance")
            return None
        for row, numbers in enumerate((state.position, state.velocity, state.effort)):
            self._values[row, ours] = numbers[theirs] if numbers.size else np.nan
        ages = self._ages.setdefault(sender, Ages())
        self._stamps[ours] = stamp_ns
        self._acquired[ours] = ages.acquired(stamp_ns, arrival)
        self._fresh[ours] = True
        self.problem = ""
        if not self._fresh.all():
            return None
        self._fresh[:] = False
        position, velocity, effort = (vector(row) for row in self._values)
        whole = JointState(position, _known(velocity), _known(effort), self._joints)
        return Measured(whole, float(self._acquired.min()), arrival)

    @property
    def trouble(self) -> str:
        """Why nothing new comes of all joints, as far as messages say that; empty if they say nothing."""
        if self.problem:
            return self.problem
        if not self._fresh.any():
            return ""
        names = [name for name, fresh in zip(self._joints, self._fresh, strict=True) if not fresh]
        return f"no message has {', '.join(names)}"

    def not_read(self, why: str) -> None:
        """Count a message whose bytes are none."""
        self._refuse("not readable", why)

    def _refuse(self, kind: str, why: str) -> None:
        self.counts[kind] += 1
        self.problem = why

    def _order(self, names: tuple[str, ...]) -> tuple[Places, Places]:
        """Return the places of our joints in a message, and in the device."""
        if names not in self._orders:
            if len(self._orders) > len(self._joints) + 16:
                self._orders.clear()
            pairs = [
                (at, self._places[name]) for at, name in enumerate(names) if name in self._places
            ]
            table = np.array(pairs, dtype=np.intp).reshape(-1, 2)
            self._orders[names] = table[:, 0], table[:, 1]
        return self._orders[names]

    def _trouble(
        self, state: JointState, theirs: Places, ours: Places, stamp_ns: int
    ) -> tuple[str, str] | None:
        if stamp_ns <= 0:
            return "without a stamp", "it has no stamp"
        if not state.position.size:
            return "without positions", "it has no positions"
        finite = np.isfinite(state.position[theirs])
        if not finite.all():
            name = self._joints[ours[int(np.argmin(finite))]]
            return "not finite", f"the position of {name} is not finite"
        return None

    def _belong_to(self, ours: Places, sender: Hashable) -> bool:
        """Whether a sender may tell of these joints: the first one of each, for the whole connection.

        Where that one falls silent, another one must not go on for it unnoticed.
        """
        if any(self._owners[place] not in (None, sender) for place in ours):
            return False
        for place in ours:
            self._owners[place] = sender
        return True


def _known(values: Vector) -> Vector:
    return values if np.isfinite(values).all() else empty()


def _twice(names: tuple[str, ...]) -> str:
    return max(names, key=names.count)
