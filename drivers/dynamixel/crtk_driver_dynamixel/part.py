"""The servos of one CRTK device on a chain, the arm or the gripper: torque, modes, goals, what is wrong.

A mode is a value of the register Operating Mode, which is written only while torque is off and resets gains,
profile and goals. So a change of mode is a procedure of a few cycles: torque off, mode, everything that it
reset, a goal that moves nothing, and torque on again only after all of that was read back. Meanwhile the
newest setpoint waits.
"""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from crtk_driver_dynamixel import registers
from crtk_driver_dynamixel.chain_link import ChainLink
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.joints import Chain
from crtk_driver_dynamixel.models import OperatingMode
from crtk_driver_dynamixel.preparation import ATTEMPTS, recover, set_up
from crtk_driver_dynamixel.readings import Frame
from crtk_driver_dynamixel.servo_state import KEPT, Values
from crtk_driver_dynamixel.units import Counts
from crtk_drivers.commands import Kind
from crtk_drivers.device import Steps
from crtk_drivers.errors import DeviceFault

__all__ = ["Part"]

GOALS: Final[Mapping[OperatingMode, str]] = {
    OperatingMode.CURRENT: "goal_current",
    OperatingMode.VELOCITY: "goal_velocity",
    OperatingMode.PWM: "goal_pwm",
}
"""Register that a setpoint goes to; in the modes for positions it is Goal Position."""

SETTLE_TIME: Final = 0.5
"""Seconds that a stopped servo may take to stand."""
STANDING: Final = 1
"""Counts of Present Velocity of a servo that stands."""


Number = TypeVar("Number", np.int64, np.bool_, np.float64)


class _Pending(NamedTuple):
    kind: Kind
    counts: Counts


class Part:
    """The servos of some joints of a chain, with one mode.

    All methods are for the I/O thread, but `ask_to_stop`.

    Args:
        link: to the chain.
        joints: their places among the joints of the chain.
        config: of the chain.

    Attributes:
        kind: of the setpoints that the servos take now; None while their torque is off.
    """

    def __init__(self, link: ChainLink, joints: range, config: DynamixelConfig) -> None:
        self._link = link
        self._joints = joints
        self._config = config
        self._whole = link.chain
        self._chain = link.chain.part(joints)
        self.places = link.chain.places_of(joints)
        self._index = np.array(self.places)
        self._commanded = np.array(
            [i for i, p in enumerate(self.places) if link.chain.servos[p].follow == "goals"]
        )
        self._has_profile = any(
            link.chain.servos[place].config.profile_velocity > 0.0 for place in self.places
        )
        self.kind: Kind | None = None
        self._work: Steps | None = None
        self._pending: _Pending | None = None
        self._fault = ""
        self._is_free = False
        self._stop = threading.Event()
        self._goals: Counts | None = None
        self._goal_registers: dict[Kind, list[tuple[str, NDArray[np.int64]]]] = {}

    @property
    def goals(self) -> Counts | None:
        """Where servos with a profile of their own are on the way to (servos of this part,), or stand.

        None without a profile, and as long as it is not known.
        """
        holds = self.kind is Kind.POSITION and not self._is_free and self.takes_setpoints
        return self._goals if holds and self._has_profile else None

    @property
    def chain(self) -> Chain:
        """The chain of these joints alone, as calibrated."""
        if self._whole is not self._link.chain:
            self._whole = self._link.chain
            self._chain = self._whole.part(self._joints)
        return self._chain

    @property
    def takes_setpoints(self) -> bool:
        """Whether a setpoint takes effect at once: no change of mode and no stop is under way."""
        return self._work is None and not self._stop.is_set()

    def own(self, values: NDArray[Number]) -> NDArray[Number]:
        """Return the values of these servos out of those of the chain."""
        own: NDArray[Number] = values[self._index]
        return own

    # -------------------------------------------------------------------------------- what is wrong

    def found(self) -> None:
        """The chain was opened: take the servos as they are, holding in some mode or without torque."""
        self._forget()
        self.kind = None

    def _forget(self) -> None:
        """Forget what was under way, and what was wrong."""
        self._work = self._pending = None
        self._fault = ""
        self._is_free = False
        self._stop.clear()

    def has_company(self, frame: Frame, now: float) -> bool:
        """Whether other servos of the chain still answer."""
        others = np.delete(frame.seen, self._index)
        return bool((others >= now - self._config.silent_timeout).any())

    def silent(self, frame: Frame, now: float) -> list[int]:
        """Return the places of the servos that have not answered for `silent_timeout`."""
        limit = now - self._config.silent_timeout
        return [place for place in self.places if frame.seen[place] < limit]

    def trouble(self, frame: Frame, now: float) -> str:
        """Return what keeps these servos from being used, in words; empty if nothing does."""
        found = [self._fault] if self._fault else []
        silent = self.silent(frame, now)
        found += [f"{self._name(place)} does not answer" for place in silent]
        for place in self.places:
            health = self._link.health[place]
            if health.error_text:
                found.append(f"{self._name(place)}: {health.error_text}")
            elif self.kind is None or self._is_free or self._work is not None:
                continue
            elif health.tripped:
                found.append(f"{self._name(place)}: its bus watchdog has stopped it")
            elif health.torque is False:
                found.append(
                    f"{self._name(place)}: its torque is off, perhaps it was without power"
                )
        return "; ".join(found)

    def _name(self, place: int) -> str:
        return self._link.chain.servos[place].place

    # ----------------------------------------------------------------------------------- in a cycle

    def step(self) -> None:
        """Go on with a change of mode or a stop; what fails in it is `trouble` until the next `enable`."""
        if self._work is not None:
            try:
                next(self._work)
            except StopIteration:
                self._work = None
                self._send_pending()
            except DeviceFault as fault:
                self._work = self._pending = None
                self._fault = fault.message
        if self._work is None and self._stop.is_set():
            self._stop.clear()
            self._pending = None
            self._begin_stop()

    def send(self, kind: Kind, counts: Counts) -> None:
        """Send goals (servos of this part,), after a change of mode if they need one."""
        if self._work is None and kind is self.kind:
            self._write_goals(kind, counts)
            return
        self._pending = _Pending(kind, counts)
        if self._work is None:
            self._work = self._switch(kind)

    def ask_to_stop(self) -> None:
        """Have the next cycle end all motion. From any thread."""
        self._stop.set()

    def stop_now(self) -> None:
        """End all motion in this call, as far as that is possible: nobody will call `step` any more."""
        self._stop.clear()
        if self.kind is Kind.VELOCITY:
            self._stand_still()
        elif self.kind is Kind.EFFORT or self._is_free:
            for _ in self._switch(Kind.POSITION):
                self._link.exchange()

    def _send_pending(self) -> None:
        pending, self._pending = self._pending, None
        if pending is None or self._stop.is_set():
            return
        self.send(*pending)

    def _begin_stop(self) -> None:
        if self.kind is Kind.VELOCITY and self._is_troubled():
            # A change of mode would take the torque away, and may not come to its end.
            self._stand_still()
        else:
            self._work = self._rest()

    def _is_troubled(self) -> bool:
        return bool(self.trouble(self._frame, time.monotonic()))

    def _rest(self) -> Steps:
        """Bring the servos to rest, and hold them there by position; those that still do what they are told.

        Raises:
            DeviceFault: one does not.
        """
        if self.kind is Kind.VELOCITY:
            self._stand_still()
            end = time.monotonic() + SETTLE_TIME
            while time.monotonic() < end:
                yield
                frame = self._frame
                speeds = self.own(frame.velocity)[self.own(frame.valid)]
                if np.abs(speeds).max(initial=0) <= STANDING:
                    break
        if self._is_free or self.kind in (Kind.VELOCITY, Kind.EFFORT):
            gone = {*self.silent(self._frame, time.monotonic()), *self._broken()}
            if self.kind is Kind.EFFORT:
                # They may hear, though they do not answer.
                nothing = {p: {self._goal_register(p, Kind.EFFORT): 0} for p in gone}
                self._link.write_values(nothing)
            yield from self._switch(Kind.POSITION, [p for p in self.places if p not in gone])
            self._is_free = False
        elif self.kind is Kind.POSITION and self._has_profile:
            # The servos may be far behind their goals.
            self._write_goals(Kind.POSITION, self.own(self._frame.position))

    def _broken(self) -> list[int]:
        return [place for place in self.places if self._link.health[place].error_text]

    def _stand_still(self) -> None:
        self._write_goals(Kind.VELOCITY, np.zeros(len(self.places), dtype=np.int64))

    def _write_goals(self, kind: Kind, counts: Counts) -> None:
        self._goals = counts if kind is Kind.POSITION else None
        for register, index in self._registers(kind):
            self._link.send(register, [self.places[i] for i in index], counts[index])

    def _registers(self, kind: Kind) -> Sequence[tuple[str, NDArray[np.int64]]]:
        """Return the registers that setpoints of a kind go to, each with the servos of this part."""
        found = self._goal_registers.get(kind)
        if found is None:
            by_name: dict[str, list[int]] = defaultdict(list)
            for i in self._commanded.tolist():
                by_name[self._goal_register(self.places[i], kind)].append(i)
            found = [(name, np.array(index)) for name, index in by_name.items()]
            self._goal_registers[kind] = found
        return found

    def _goal_register(self, place: int, kind: Kind) -> str:
        return GOALS.get(self._mode(place, kind), "goal_position")

    @property
    def _frame(self) -> Frame:
        frame = self._link.frame
        assert frame is not None
        return frame

    # ---------------------------------------------------------------------------------- transitions

    def enable(self) -> Steps:
        """Restart servos with errors, set all up, and hold them where they are.

        Raises:
            TransitionFailed: with what is in the way.
            DeviceFault: servos do not do what they are told.
        """
        self._forget()
        yield from recover(self._link, self.places)
        yield from set_up(self._link, self.places, self._config)
        self._link.write_values(self._each({"bus_watchdog": 0}))
        yield from self._switch(Kind.POSITION)
        watchdog = registers.watchdog_count(self._config.watchdog)
        yield from self._make_sure(self._each({"bus_watchdog": watchdog}))
        self._link.read_health(self.places)
        end = time.monotonic() + SETTLE_TIME
        while self.silent(self._frame, time.monotonic()) and time.monotonic() < end:
            yield  # one that was silent before is read only now and then

    def disable(self) -> Steps:
        """Take the torque away, or leave the servos holding, as configured.

        Raises:
            DeviceFault: a servo keeps its torque.
        """
        self._work = self._pending = None
        self._stop.clear()
        if self._config.disable == "torque_off":
            if self.kind is Kind.VELOCITY:
                self._stand_still()
            self.kind = None
            self._is_free = False
            yield from self._make_sure(self._each({"bus_watchdog": 0, "torque_enable": 0}))
        else:
            yield from self._rest()
            yield from self._make_sure(self._each({"bus_watchdog": 0}))
        self._link.read_health(self.places)

    def free(self) -> Steps:
        """Take the torque away, so that the joints can be moved by hand, until `ask_to_stop`.

        Raises:
            DeviceFault: a servo keeps its torque.
        """
        self._is_free = True
        yield from self._make_sure(self._each({"torque_enable": 0}))
        while True:
            yield

    def let_go(self) -> None:
        """Take the torque away now; the next cycles make sure of those that answer."""
        self._link.write_values(self._each({"torque_enable": 0}))
        self.kind = self._pending = None
        self._is_free = False
        gone = self.silent(self._frame, time.monotonic())
        held = {place: {"torque_enable": 0} for place in self.places if place not in gone}
        self._work = self._make_sure(held, written=True)

    def leave(self) -> None:
        """End motion, and have the servos hold on though nobody will talk to them any more.

        Raises:
            ConnectionLost: the adapter is gone; the servos' own watchdogs end motion then.
            DeviceFault: servos do not do what they are told.
        """
        if self._stop.is_set():
            self.stop_now()
        self._link.write_values(self._each({"bus_watchdog": 0}))

    def _each(self, values: Values) -> dict[int, Values]:
        return dict.fromkeys(self.places, values)

    # --------------------------------------------------------------------------------------- modes

    def _switch(self, kind: Kind, places: Sequence[int] | None = None) -> Steps:
        """Bring servos, all unless told otherwise, into a mode, holding still, with torque.

        Raises:
            DeviceFault: they do not do what they are told.
        """
        link, places = self._link, self.places if places is None else places
        modes = {place: int(self._mode(place, kind)) for place in places}
        changing = {
            place: {"operating_mode": mode}
            for place, mode in modes.items()
            if link.states[place].values.get("operating_mode", mode) != mode
        }
        self.kind = self._goals = None
        if changing:
            yield from self._make_sure({place: {"torque_enable": 0} for place in changing})
            yield from self._make_sure(changing)
        waiting, wrong = list(places), dict[int, list[str]]()
        for _ in range(ATTEMPTS):
            here = link.read_positions(waiting)
            wanted = {place: self._still(place, kind, count) for place, count in here.items()}
            link.write_values(wanted)
            wrong = self._wrong(wanted)
            held = [place for place in wanted if place not in wrong]
            # Only now: with another goal they would jump.
            link.write_values({place: {"torque_enable": 1} for place in held})
            waiting = [place for place in waiting if place not in held]
            if not waiting:
                break
            yield
        else:
            raise self._stubborn({place: wrong.get(place, ["no answer"]) for place in waiting})
        yield
        yield from self._make_sure({p: {"torque_enable": 1} for p in places}, written=True)
        self.kind = kind
        for place in places:
            link.health[place].torque = True

    def _mode(self, place: int, kind: Kind) -> OperatingMode:
        servo = self._link.chain.servos[place]
        if kind is Kind.VELOCITY:
            return OperatingMode.VELOCITY
        if kind is Kind.EFFORT:
            assert servo.effort_mode is not None
            return servo.effort_mode
        return servo.units.mode

    def _still(self, place: int, kind: Kind, count: int) -> dict[str, int]:
        """Return what the RAM of a servo at a count must hold before torque goes on, its goal included."""
        link = self._link
        state, servo = link.states[place], link.chain.servos[place]
        wanted: dict[str, int] = {n: state.values[n] for n in KEPT if n in state.values}
        settings = registers.ram(servo, state.table, self._config, state.values)
        wanted |= {s.item.name: s.value for s in settings if not s.item.eeprom}
        if servo.effort_mode is OperatingMode.PWM and "pwm_limit" in state.values:
            # What Goal PWM was in PWM mode would limit the voltage in the other modes.
            wanted.setdefault("goal_pwm", state.values["pwm_limit"])
        goal = self._goal_at(place, count) if kind is Kind.POSITION else 0
        wanted[self._goal_register(place, kind)] = goal
        return {name: value for name, value in wanted.items() if state.has(name)}

    def _goal_at(self, place: int, count: int) -> int:
        """Return where a servo is, as a goal that it takes.

        Raises:
            DeviceFault: it is where it takes no goal, and would jump.
        """
        values = self._link.states[place].values
        if self._mode(place, Kind.POSITION) == OperatingMode.POSITION:
            family = self._link.chain.servos[place].units.model.family
            low = values.get("min_position_limit", family.lowest)
            high = values.get("max_position_limit", family.highest)
            if not low <= count <= high:
                raise DeviceFault(
                    f"{self._name(place)} stands at count {count}, outside its own limits {low} to {high}",
                    where=self._link.address,
                    remedy="Move the joint into its range by hand, with the torque off, and enable again.",
                )
        return count

    def _make_sure(self, wanted: Mapping[int, Values], *, written: bool = False) -> Steps:
        """Write registers until they hold these values.

        Raises:
            DeviceFault: they never do.
        """
        wanted = {
            place: known
            for place, values in wanted.items()
            if (known := {n: v for n, v in values.items() if self._link.states[place].has(n)})
        }
        wrong: dict[int, list[str]] = {}
        for attempt in range(ATTEMPTS):
            if attempt or not written:
                self._link.write_values(wanted)
                yield
            wrong = self._wrong(wanted)
            if not wrong:
                return
            wanted = {place: wanted[place] for place in wrong}
        raise self._stubborn(wrong)

    def _wrong(self, wanted: Mapping[int, Values]) -> dict[int, list[str]]:
        """Return which registers of which servos do not hold what they should; those that do are kept."""
        names = sorted({name for values in wanted.values() for name in values})
        found = self._link.read_values(wanted, names) if names else {}
        wrong: dict[int, list[str]] = {}
        for place, values in wanted.items():
            read = found.get(place, {})
            differing = [name for name, value in values.items() if read.get(name) != value]
            if differing:
                wrong[place] = differing
            self._link.learn(place, read)
        return wrong

    def _stubborn(self, wrong: Mapping[int, Iterable[str]]) -> DeviceFault:
        told = "; ".join(
            f"{self._name(place)}: {', '.join(names)}" for place, names in wrong.items()
        )
        return DeviceFault(
            f"registers do not take what is written: {told}",
            where=self._link.address,
            remedy="Does it answer reliably, and is its supply right? See the counters in diagnostics.",
        )
