"""The servos of one CRTK device on a chain, the arm or the gripper: torque, goals, stops, what is wrong.

A change of mode takes a few cycles (`crtk_driver_dynamixel.modes`), in which the newest setpoint waits. So
does a stop (`crtk_driver_dynamixel.stopping`): it goes on, whatever is lost on the wire, until it was read
back, and until then the servos' bus watchdogs stay armed on every way out.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from crtk_driver_dynamixel import registers
from crtk_driver_dynamixel.chain_link import ChainLink
from crtk_driver_dynamixel.config import DynamixelConfig, GripperConfig
from crtk_driver_dynamixel.confirmed import make_sure
from crtk_driver_dynamixel.goals import SentGoals
from crtk_driver_dynamixel.joints import Chain
from crtk_driver_dynamixel.models import OperatingMode
from crtk_driver_dynamixel.modes import Modes
from crtk_driver_dynamixel.own_limits import wider
from crtk_driver_dynamixel.own_profile import Approach
from crtk_driver_dynamixel.preparation import obstacles, recover, set_up, unheard, unset
from crtk_driver_dynamixel.readings import Frame
from crtk_driver_dynamixel.servo_state import Values
from crtk_driver_dynamixel.stopping import Stopping
from crtk_driver_dynamixel.units import Counts
from crtk_drivers.commands import Kind
from crtk_drivers.device import Steps
from crtk_drivers.errors import DeviceError, DeviceFault, StopUnconfirmed, raise_first
from crtk_drivers.kit.waiting_steps import until

logger = logging.getLogger(__name__)

SETTLE_TIME: Final = 0.5
"""Seconds in which a servo that was silent is heard again, after it was enabled."""
CUT_POWER: Final = "Switch the supply of the servos off if it moves."
COUNTING: Final = frozenset({"homing_offset", "drive_mode"})
"""EEPROM that says from where and in which direction a servo counts."""
LEAVE_TIME: Final = 0.6
"""Seconds in which servos are brought to rest before the port is closed."""


Number = TypeVar("Number", np.int64, np.bool_, np.float64)


class _Pending(NamedTuple):
    kind: Kind
    counts: Counts


class Part:
    """The servos of some joints of a chain, with one mode.

    All methods are for the I/O thread, but `ask_to_stop` and `stop_from_outside`.

    Args:
        link: to the chain.
        joints: their places among the joints of the chain.
        config: of the chain.

    Attributes:
        kind: of the setpoints that the servos take now; None while their torque is off.
        found: which had torque or turned when the chain was opened, in words.
    """

    def __init__(self, link: ChainLink, joints: range, config: DynamixelConfig) -> None:
        self._link = link
        self._joints = joints
        self._config = config
        self._whole = link.chain
        self._chain = link.chain.part(joints)
        self.places = link.chain.places_of(joints)
        self._index = np.array(self.places)
        configs = [link.chain.servos[place].config for place in self.places]
        self._has_profile = any(each.profile_velocity > 0.0 for each in configs)
        is_gripper = any(isinstance(each, GripperConfig) for each in configs)
        self._stops_elsewhere = self._has_profile or (
            not is_gripper and any(each.yields for each in configs)
        )
        self.kind: Kind | None = None
        self._modes = Modes(link, config)
        self._stopping = Stopping(link, self._modes, self.places)
        self._work: Steps | None = None
        self._is_stopping = False
        self._armed = False
        self._has_told_limits = False
        self.found = ""
        self._pending: _Pending | None = None
        self._fault = ""
        self._is_free = False
        self._stop = threading.Event()
        self._sent = SentGoals(link, self._modes, self.places)
        self._approach = Approach(configs, self.places)

    @property
    def goals(self) -> Counts | None:
        """Where servos are on the way to (servos of this part,), or are held after a stop.

        None where that is what was sent, and as long as it is not known. Servos with a profile, or that
        yield, are held elsewhere after a stop.
        """
        holds = self.kind is Kind.POSITION and not self._is_free and self.takes_setpoints
        return self._sent.positions if holds and self._stops_elsewhere else None

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

    @property
    def has_arrived(self) -> bool:
        """Whether the servos are where they were sent, or stand where something holds them.

        Of those that neither have a profile of their own nor yield the core knows better.
        """
        if not self.takes_setpoints:
            return False
        if self.kind is not Kind.POSITION or self._is_free:
            return True
        return self._approach.has_ended(self._sent.positions)

    @property
    def turning(self) -> bool:
        """Whether a file says which turns these servos are in."""
        servos = (self._link.chain.servos[place] for place in self.places)
        has_turns = any(servo.units.mode is not OperatingMode.POSITION for servo in servos)
        return has_turns and bool(self._config.turns)

    @property
    def doubts(self) -> list[str]:
        """Of which servos it is not known which turn they are in, and why."""
        return [text for place, text in self._link.placement.doubts.items() if place in self.places]

    @property
    def stop_time(self) -> float:
        """Seconds in which the servos stand after they were told to stop, mode and all."""
        return self._stopping.time + SETTLE_TIME

    @property
    def has_stopped(self) -> bool:
        """Whether what was asked for by `ask_to_stop` last was read back from every servo."""
        return not (self._stop.is_set() or self._is_stopping or self._stopping.unconfirmed)

    def own(self, values: NDArray[Number]) -> NDArray[Number]:
        """Return the values of these servos out of those of the chain."""
        own: NDArray[Number] = values[self._index]
        return own

    # -------------------------------------------------------------------------------- what is wrong

    def take_over(self) -> None:
        """The chain was opened: take the servos as they are, holding in some mode or without torque."""
        self._forget()
        self._sent.forget()
        self.kind = None
        self._armed = False
        self._stopping.unconfirmed = ()
        self.found = self._found()

    def _found(self) -> str:
        """Return which servos have torque, and which turn, in words; empty if none."""
        servos, health = self._link.chain.servos, self._link.health
        on = [servos[place].name for place in self.places if health[place].torque]
        told = [f"torque is on: {', '.join(dict.fromkeys(on))}"] if on else []
        told += [f"{self._name(place)} turns" for place in self._link.turning(self.places)]
        return "; ".join(told)

    def _forget(self) -> None:
        """Forget what was under way, and what was wrong."""
        self._work = self._pending = None
        self._fault = ""
        self._is_free = self._is_stopping = False
        self._stop.clear()

    def has_company(self) -> bool:
        """Whether other servos of the chain still answer."""
        others = np.delete(self._link.silences.lasting, self._index)
        return bool((others <= self._config.silent_timeout).any())

    def silent(self) -> list[int]:
        """Return the places of the servos that have not answered for `silent_timeout`."""
        silences, limit = self._link.silences.lasting, self._config.silent_timeout
        return [place for place in self.places if silences[place] > limit]

    def trouble(self) -> str:
        """Return what keeps these servos from being used, in words; empty if nothing does."""
        found = [self._fault] if self._fault else []
        found += [f"{self._name(place)} does not answer" for place in self.silent()]
        for place in self.places:
            health = self._link.health[place]
            if health.error_text:
                found.append(f"{self._name(place)}: {health.error_text}")
            elif self.kind is None or self._work is not None:
                continue
            elif health.tripped and not self._is_free:
                found.append(f"{self._name(place)}: its bus watchdog has stopped it")
            elif health.torque is False and not self._is_free:
                found.append(
                    f"{self._name(place)}: its torque is off, perhaps it was without power"
                )
            elif self._was_reset(place):
                found.append(f"{self._name(place)}: it was reset, perhaps it was without power")
        return "; ".join(found)

    def _was_reset(self, place: int) -> bool:
        """Whether registers of a servo are as after a start, though it was set up otherwise."""
        health, values = self._link.health[place], self._link.states[place].values
        if health.watchdog == 0 and self._armed and self._config.watchdog:
            return True
        level = values.get("status_return_level", health.return_level)
        return health.return_level is not None and health.return_level != level

    def _name(self, place: int) -> str:
        return self._link.chain.servos[place].place

    # ----------------------------------------------------------------------------------- in a cycle

    def step(self) -> None:
        """Go on with a change of mode or a stop; what fails in it is `trouble` until the next `enable`."""
        self._approach.look(self._frame, self._sent.positions)
        if self._is_stopping and self._stop.is_set():
            self._stop.clear()
            self._pending = None
        if self._work is not None:
            self._go_on(self._work)
        if self._work is None and self._stop.is_set():
            self._stop.clear()
            self._pending = None
            self._is_stopping = True
            self._work = self._come_to_rest()
            self._go_on(self._work)
        if self._work is None and not self._fault:
            here = self.own(self._frame.position)
            self._fault = self._sent.refused() or self._sent.stuck(here)

    def _go_on(self, work: Steps) -> None:
        try:
            next(work)
        except StopIteration:
            self._work = None
            self._is_stopping = False
            self._send_pending()
        except DeviceFault as fault:
            self._work = self._pending = None
            self._is_stopping = False
            self._fault = fault.message

    def send(self, kind: Kind, counts: Counts) -> None:
        """Send goals (servos of this part,), after a change of mode if they need one."""
        if self._work is None and kind is self.kind:
            self._sent.send(kind, counts)
            return
        self._pending = _Pending(kind, counts)
        if self._work is None:
            self._work = self._switch(kind)

    def ask_to_stop(self) -> None:
        """Have the next cycle end all motion. From any thread."""
        self._stop.set()

    def stop_at_once(self) -> None:
        """End velocities and efforts now: on a line that has fallen silent a cycle takes its time."""
        if self._is_driven:
            self._stopping.write(self.places)

    def stop_from_outside(self) -> None:
        """End velocities and efforts now, from another thread: nobody may call `step` any more."""
        if self._is_driven:
            self._stopping.write_from_outside()

    @property
    def _is_driven(self) -> bool:
        return self.kind in (Kind.VELOCITY, Kind.EFFORT) and not self._is_free

    def _send_pending(self) -> None:
        pending, self._pending = self._pending, None
        if pending is None or self._stop.is_set():
            return
        self.send(*pending)

    def _come_to_rest(self) -> Steps:
        """Bring the servos to rest, and hold them there by position; those that still do what they are told.

        It goes on, telling what is the matter, until every servo is known to have stopped.

        Raises:
            DeviceFault: one does not change its mode; it has stopped before.
        """
        stopping = self._stopping
        here = self.own(self._frame.position)
        held = self._sent.held(here, where_they_are=self._has_profile)
        if not held:
            self._sent.forget()
        self._decide(held)
        # A change of mode would take the torque away, and may not come to its end.
        may_switch = self.kind is not Kind.VELOCITY or not self._is_troubled()
        is_ours = self.kind is not None and not self._is_free
        for reason in stopping.until_confirmed(self._answering, held, at_once=is_ours):
            if reason and not self._fault:
                self._fault = reason
            yield
            self._decide(held)
        left_out: list[int] = []
        if may_switch and (self._is_free or self.kind in (Kind.VELOCITY, Kind.EFFORT)):
            places = self._answering()
            left_out = [place for place in self.places if place not in places]
            if self.kind is Kind.EFFORT and not self._is_free and self._modes.near_the_end(places):
                # It may be on its way over the seam: it is brought to rest in a mode that knows turns.
                yield from self._rest_by_velocity(places)
            yield from self._hold_here(places)
            self._is_free = False
        for _ in stopping.until_confirmed(lambda: self.places, held, at_once=is_ours):
            yield
            self._decide(held)
        # Who was silent meanwhile may be heard again before anybody has taken it for a fault.
        back = [place for place in self._answering() if place in left_out]
        if back:
            yield from self._hold_here(back)

    def _decide(self, held: dict[int, int | None]) -> None:
        frame = self._frame
        self._sent.decide(held, self.own(frame.position), self.own(frame.valid))

    def _hold_here(self, places: Sequence[int]) -> Steps:
        raise_first(self._modes.misplaced(self._link.read_positions(places)))
        yield from self._switch(Kind.POSITION, places)

    def _rest_by_velocity(self, places: Sequence[int]) -> Steps:
        if not self._takes_velocities():
            return
        yield from self._switch(Kind.VELOCITY, places)
        for _ in self._stopping.until_confirmed(self._answering, at_once=True):
            yield

    def _takes_velocities(self) -> bool:
        servos = (self._link.chain.servos[place] for place in self.places)
        return all(servo.takes_velocities for servo in servos)

    def _answering(self) -> list[int]:
        """Return the servos that answer and have no error: those that do what they are told."""
        gone = {*self.silent(), *self._broken()}
        return [place for place in self.places if place not in gone]

    def _is_troubled(self) -> bool:
        return bool(self.trouble())

    def _broken(self) -> list[int]:
        return [place for place in self.places if self._link.health[place].error_text]

    @property
    def _frame(self) -> Frame:
        frame = self._link.frame
        assert frame is not None
        return frame

    # ---------------------------------------------------------------------------------- transitions

    def obstacles(self) -> Iterator[DeviceError]:
        """Yield what `enable` fails on now, by what was read last."""
        link, frame = self._link, self._link.frame
        if frame is None or self.kind is not None:
            return
        silent = self.silent()
        if silent:
            names = ", ".join(map(self._name, silent))
            yield unheard(link, names)
        heard = [place for place in self.places if frame.valid[place]]
        wanted = {place: unset(link, place, self._config) for place in heard}
        yield from obstacles(link, wanted, self._config)
        # With what is to be written into these, a servo counts otherwise.
        counted = [place for place in heard if not COUNTING & wanted[place].keys()]
        yield from self._modes.misplaced({place: int(frame.position[place]) for place in counted})

    def enable(self) -> Steps:
        """Restart servos with errors, set all up, and hold them where they are.

        The bus watchdog is armed before any torque comes on.

        Raises:
            TransitionFailed: with what is in the way.
            DeviceFault: servos do not do what they are told.
        """
        self._forget()
        self._sent.forget()
        link, places = self._link, self.places
        held = self._on_their_way()
        for reason in self._stopping.until_confirmed(self._answering, held, at_once=False):
            if reason:
                raise DeviceFault(reason, where=link.address, remedy=CUT_POWER)
            yield
        yield from recover(link, places)
        yield from set_up(link, places, self._config)
        self._tell_limits()
        raise_first(self._modes.misplaced(link.read_positions(places)))
        self._armed = True
        tripped = [place for place in places if link.health[place].tripped]
        yield from make_sure(link, {p: {"bus_watchdog": 0} for p in tripped})
        watchdog = registers.watchdog_count(self._config.watchdog)
        yield from make_sure(link, self._each({"bus_watchdog": watchdog}))
        yield from self._switch(Kind.POSITION)
        link.read_health(places)
        end = time.monotonic() + SETTLE_TIME
        while self.silent() and time.monotonic() < end:
            yield  # one that was silent before is read only now and then

    def _on_their_way(self) -> dict[int, int]:
        """Return where servos are, by place, that another program has left on the way to a position."""
        return {
            place: int(self._frame.position[place])
            for place in self._link.turning(self.places)
            if self._modes.stop_register(place) is None
        }

    def _tell_limits(self) -> None:
        """Tell, once, which servos would go further by themselves than the configuration lets them."""
        if self._has_told_limits:
            return
        self._has_told_limits = True
        link = self._link
        told = wider(link.chain, {place: link.states[place] for place in self.places})
        if told:
            logger.info(
                "%s: the servos' own limits are wider than the configuration: %s. As a second line they "
                "should be as narrow: crtk-driver dynamixel limits writes them (--no-write: shows them)",
                link.address,
                told,
            )

    def disable(self) -> Steps:
        """Take the torque away, or leave the servos holding, as configured.

        Raises:
            DeviceFault: a servo keeps its torque.
        """
        self._pending = None
        if self._config.disable == "torque_off":
            self._work, self._is_stopping = None, False
            self._stop.clear()
            yield from self._power_off()
        else:
            self.ask_to_stop()
            while not self.takes_setpoints:
                yield
            yield from self._disarm(self.places)
        self._link.read_health(self.places)

    def _power_off(self) -> Steps:
        """Take the torque away; the watchdogs are disarmed only when it is known to be off.

        Raises:
            DeviceFault: a servo keeps its torque; it is told to stop until it does.
        """
        if self.kind is not None:
            self._stopping.write(self.places)
        self.kind = None
        self._sent.forget()
        self._is_free = False
        try:
            yield from make_sure(self._link, self._each({"torque_enable": 0}))
        except DeviceFault:
            self.ask_to_stop()
            raise
        self._stopping.unconfirmed = ()
        yield from self._disarm(self.places)

    def _disarm(self, places: Sequence[int]) -> Steps:
        yield from make_sure(self._link, {p: {"bus_watchdog": 0} for p in places})
        self._armed = False

    def free(self) -> Steps:
        """Take the torque away, so that the joints can be moved by hand, until `ask_to_stop`.

        Raises:
            DeviceFault: a servo keeps its torque.
        """
        self._pending = None
        # At its end a change of mode, or a stop, gives the torque back.
        while not self.takes_setpoints:
            yield
        self._is_free = True
        self._sent.forget()
        yield from make_sure(self._link, self._each({"torque_enable": 0}))
        while True:
            yield

    def trust(self) -> None:
        """Take the servos to be in the turns that they are believed to be in."""
        self._link.placement.trust(self.places)

    def distrust(self) -> None:
        """Take the servos of more than one turn as not homed."""
        self._link.placement.distrust(self.places)

    def let_go(self) -> None:
        """Take the torque away now; the next cycles make sure of those that answer."""
        self._link.write_values(self._each({"torque_enable": 0}))
        self.kind = self._pending = None
        self._sent.forget()
        self._is_free = self._is_stopping = False
        gone = self.silent()
        held = {place: {"torque_enable": 0} for place in self.places if place not in gone}
        self._work = make_sure(self._link, held, written=True)

    def leave(self) -> None:
        """End motion, read back that it has ended, and leave the servos as `on_close` says.

        Servos that were not enabled are left as they are. The bus watchdog of a servo that is not known to
        have stopped stays armed, and it hears nothing any more.

        Raises:
            ConnectionLost: the adapter is gone; the servos' own watchdogs end motion then.
            StopUnconfirmed: it could not be read back that all have stopped; with who it is.
        """
        if not self._armed and self.kind is None and self.has_stopped:
            return
        limit = max(LEAVE_TIME, self._stopping.time)
        for _ in until(lambda: self.has_stopped and self._work is None, limit):
            if self._work is not None or self._stop.is_set():
                self.step()
            else:
                self.ask_to_stop()
            self._link.exchange()
        stopped = [place for place in self.places if place not in self._stopping.unconfirmed]
        if not self.has_stopped and len(stopped) == len(self.places):
            stopped = []  # it has not come so far
        off = self._config.on_close == "power_off"
        try:
            for _ in self._power_off() if off else self._disarm(stopped):
                self._link.exchange()
        except DeviceFault as fault:
            if off:
                raise self.unconfirmed from fault
            # Its watchdog will stop it, where it stands.
            logger.warning("%s: %s", self._link.address, fault.message)
        if len(stopped) < len(self.places):
            raise self.unconfirmed

    @property
    def unconfirmed(self) -> StopUnconfirmed:
        """What is to be said of servos that are not known to have stopped."""
        places = self._stopping.unconfirmed or self.places
        timeout = self._config.watchdog
        own = f"Its own watchdog stops it in {timeout:g} s. " if timeout else ""
        return StopUnconfirmed(
            f"{', '.join(map(self._name, places))}: not seen to have stopped",
            where=self._link.address,
            remedy=f"{own}Look at the arm, and {CUT_POWER[0].lower()}{CUT_POWER[1:]}",
        )

    def _each(self, values: Values) -> dict[int, Values]:
        return dict.fromkeys(self.places, values)

    def _switch(self, kind: Kind, places: Sequence[int] | None = None) -> Steps:
        """Bring servos, all unless told otherwise, into the mode for a kind of setpoints."""
        self.kind = None
        self._sent.forget()
        yield from self._modes.switch(kind, self.places if places is None else places)
        self.kind = kind
