"""Operating modes of the servos of one device, and the way from one to another.

A mode is a value of the register Operating Mode, which is written only while torque is off and resets gains,
profile and goals. So a change of mode is a procedure of a few cycles: torque off, mode, everything that it
reset, a goal that moves nothing, and torque on again only after all of that was read back.

No change of mode changes what a position means: position mode knows one turn of the encoder only, and a servo
that has left it is not sent there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from crtk_driver_dynamixel import registers
from crtk_driver_dynamixel.chain_link import ChainLink
from crtk_driver_dynamixel.config import DynamixelConfig, JointConfig
from crtk_driver_dynamixel.confirmed import make_sure, stubborn, wrong
from crtk_driver_dynamixel.models import GOALS, OperatingMode
from crtk_driver_dynamixel.preparation import ATTEMPTS
from crtk_driver_dynamixel.servo_state import KEPT, Values, encoder_turn, position_limits
from crtk_drivers.commands import Kind
from crtk_drivers.device import Steps
from crtk_drivers.errors import DeviceFault, raise_first

BY_HAND: Final = (
    "Move the joint into its range by hand, with the torque off, and enable again. If it is in its range "
    "already, it was turned over the end of its encoder's turn: switch its supply off and on."
)

WHEEL: Final = 1
"""Control Mode (11) of an XL-320 that turns on and on."""

APART: Final = 0.1
"""rad by which two servos of a gripper may disagree; those of a joint by its `arrival`."""

NEAR: Final = 512
"""Counts from the end of a turn within which a servo that is not held may cross it."""


_MOVING: Final = frozenset({"goal_position", "goal_velocity"})
"""What torque and other servos may change."""

LEVEL_AT_START: Final = 2
"""Status Return Level of a servo that was switched on."""

_BOUNDS: Final = (
    ("goal_pwm", "pwm_limit"),
    ("goal_current", "current_limit"),
    ("torque_limit", "max_torque"),
)
"""Registers in RAM that bound what a servo does, and those in EEPROM that bound them."""


class Modes:
    """What mode each servo has for setpoints of a kind, and how it gets there.

    Args:
        link: to the chain.
        config: of the chain.
    """

    def __init__(self, link: ChainLink, config: DynamixelConfig) -> None:
        self._link = link
        self._config = config

    def mode(self, place: int, kind: Kind) -> OperatingMode:
        """Return the mode that a servo has for setpoints of a kind."""
        servo = self._link.chain.servos[place]
        if kind is Kind.VELOCITY:
            return OperatingMode.VELOCITY
        if kind is Kind.EFFORT:
            assert servo.effort_mode is not None
            return servo.effort_mode
        return servo.units.mode

    def present(self, place: int) -> OperatingMode:
        """Return the mode that a servo is known to be in; that for positions if it has no such register."""
        found = self._link.states[place].values.get("operating_mode")
        if found is None or found not in set(OperatingMode):
            return self.mode(place, Kind.POSITION)
        return OperatingMode(found)

    def goal_register(self, place: int, kind: Kind) -> str:
        """Return the register that setpoints of a kind go to."""
        return GOALS.get(self.mode(place, kind), "goal_position")

    def stop_register(self, place: int) -> str | None:
        """Return the register that stops a servo by 0; None where a goal position holds it."""
        values = self._link.states[place].values
        if values.get("torque_control_mode_enable"):
            return "goal_torque"
        is_wheel = values.get("cw_angle_limit") == values.get("ccw_angle_limit") == 0
        if is_wheel or values.get("control_mode") == WHEEL:
            return "moving_speed"
        return GOALS.get(self.present(place))

    def switch(self, kind: Kind, places: Sequence[int]) -> Steps:
        """Bring servos into the mode for a kind of setpoints, holding still, with torque.

        Raises:
            DeviceFault: they do not do what they are told.
        """
        link = self._link
        before = link.read_positions(places)
        modes = {place: int(self.mode(place, kind)) for place in places}
        changing = {
            place: {"operating_mode": mode}
            for place, mode in modes.items()
            if link.states[place].values.get("operating_mode", mode) != mode
        }
        if changing:
            yield from make_sure(link, {place: {"torque_enable": 0} for place in changing})
            yield from make_sure(link, changing)
        waiting, differing, goals = list(places), dict[int, list[str]](), dict[int, int]()
        written: dict[int, Values] = {}
        for _ in range(ATTEMPTS):
            here = link.read_positions(waiting)
            goals |= here
            self._check_counts(before, here)
            wanted = {place: self._still(place, kind, count) for place, count in here.items()}
            written |= wanted
            link.write_values(wanted)
            differing = wrong(link, wanted)
            held = [place for place in wanted if place not in differing]
            # Only now: with another goal they would jump.
            link.write_values({place: {"torque_enable": 1} for place in held})
            self._check_goals(kind, here, held)
            waiting = [place for place in waiting if place not in held]
            if not waiting:
                break
            yield
        else:
            raise stubborn(link, {place: differing.get(place, ["no answer"]) for place in waiting})
        yield
        yield from make_sure(link, {p: {"torque_enable": 1} for p in places}, written=True)
        self._check_goals(kind, goals, places)
        yield from self._check_written(written)
        for place in places:
            link.health[place].torque = True

    def misplaced(self, counts: Mapping[int, int]) -> Iterator[DeviceFault]:
        """Yield why servos that stand at these counts, by place, would turn as they get torque."""
        yield from self.beyond(counts)
        yield from self._apart(counts)

    def beyond(self, counts: Mapping[int, int]) -> Iterator[DeviceFault]:
        """Yield which servos have left the turn that their position mode knows.

        Position mode would take them for where they were a turn before, and its goals lead them on.

        Args:
            counts: where each is, by place.
        """
        found = [
            f"{self._link.chain.servos[place].place} stands at count {count}, outside its own limits "
            f"{low} to {high}{self._dead_zone(place)}"
            for place, count, low, high in self._in_one_turn(counts)
            if not low <= count <= high
        ]
        if found:
            yield DeviceFault("; ".join(found), where=self._link.address, remedy=BY_HAND)

    def _apart(self, counts: Mapping[int, int]) -> Iterator[DeviceFault]:
        """Yield which servos of one joint disagree: with the first setpoint they would turn on each other.

        Args:
            counts: where each is, by place.
        """
        servos = self._link.chain.servos
        at = {
            place: servos[place].units.position(count - self._ignored_homing(place))
            for place, count in counts.items()
            if servos[place].follow != "cable"
        }
        firsts = {servos[place].joint: place for place in at if servos[place].is_first}
        for place, position in at.items():
            first = firsts.get(servos[place].joint, place)
            own = servos[place].config
            allowed = own.arrival if isinstance(own, JointConfig) else APART
            if abs(position - at[first]) <= allowed:
                continue
            yield DeviceFault(
                f"{servos[place].place} is at {position:.3f} rad, and servo {servos[first].id} of this joint "
                f"at {at[first]:.3f}: they would turn against each other",
                where=self._link.address,
                remedy="Correct sign, offset or reverse of one of them, or calibrate both together: "
                "crtk-driver dynamixel calibrate.",
            )

    def _dead_zone(self, place: int) -> str:
        has_one = self._link.chain.servos[place].units.model.family.has_dead_zone
        return (
            ": at an end of its 300° it measures nothing, and may be far beyond" if has_one else ""
        )

    def near_the_end(self, places: Sequence[int]) -> bool:
        """Whether a servo is less than an eighth of a turn from the end of the turn, or beyond."""
        return any(
            not low + NEAR <= count <= high - NEAR
            for _, count, low, high in self._in_one_turn(self._link.read_positions(places))
        )

    def _in_one_turn(self, counts: Mapping[int, int]) -> Iterator[tuple[int, int, int, int]]:
        """Yield place, count and its bounds of those whose position mode knows one turn."""
        for place, count in counts.items():
            if self.mode(place, Kind.POSITION) is OperatingMode.POSITION:
                yield place, count - self._ignored_homing(place), *self._limits(place)

    def _ignored_homing(self, place: int) -> int:
        """Return what the homing offset adds to positions now, and not in position mode."""
        wanted, present = self.mode(place, Kind.POSITION), self.present(place)
        if wanted is not OperatingMode.POSITION or present is OperatingMode.POSITION:
            return 0
        state = self._link.states[place]
        offset = state.values.get("homing_offset", 0)
        return offset - state.servo.units.model.family.homing_in_force(offset)

    def _limits(self, place: int) -> tuple[int, int]:
        """Return the least and greatest count at which position mode holds a servo where it stands."""
        values = self._link.states[place].values
        family = self._link.chain.servos[place].units.model.family
        least, most = position_limits(values, family)
        first, last = encoder_turn(values, family)
        # At an end of what is measured it may as well be beyond, where it would turn back.
        beside = 1 if family.has_dead_zone else 0
        return max(least, first + beside), min(most, last - beside)

    def _check_goals(self, kind: Kind, goals: Mapping[int, int], places: Sequence[int]) -> None:
        """Make sure that servos with torque are where their goals are; take it away from those that are not.

        Raises:
            DeviceFault: one counts otherwise with torque than without, and would turn to its goal.
        """
        if kind is not Kind.POSITION:
            return
        servos = self._link.chain.servos
        found = {
            place: count
            for place, count in self._link.read_positions(places).items()
            if abs(count - goals[place]) > servos[place].units.model.family.counts // 4
        }
        if found:
            raise self._without_torque(
                {
                    place: f"counts {count} with torque, and {goals[place]} without"
                    for place, count in found.items()
                },
                "Switch its supply off and on, look where the joint is, and enable again.",
            )

    def _without_torque(self, found: Mapping[int, str], remedy: str) -> DeviceFault:
        """Take the torque away from servos again; return the fault that says why.

        Args:
            found: what is wrong, by place.
            remedy: what to do then.
        """
        link = self._link
        link.write_values({place: {"torque_enable": 0} for place in found})
        servos = link.chain.servos
        return DeviceFault(
            "; ".join(f"{servos[place].place} {what}" for place, what in found.items()),
            where=link.address,
            remedy=f"Its torque was taken away again. {remedy}",
        )

    def _check_written(self, written: Mapping[int, Values]) -> Steps:
        """Make sure that servos were not reset since they were written to, where nothing else tells.

        Torque takes current: a weak supply dips at that moment. A servo that comes back is given torque all
        the same, without its limits and its profile.

        Raises:
            DeviceFault: one was.
        """
        link = self._link
        waiting = {
            place: {name: value for name, value in values.items() if name not in _MOVING}
            for place, values in written.items()
            if not self._tells_of_a_reset(place)
        }
        for _ in range(ATTEMPTS):
            if not waiting:
                return
            names = sorted({name for values in waiting.values() for name in values})
            read = link.read_values(waiting, names)
            lost = {
                place: [n for n, value in waiting[place].items() if found.get(n) != value]
                for place, found in read.items()
            }
            lost = {place: differing for place, differing in lost.items() if differing}
            if lost:
                raise self._without_torque(
                    {
                        place: f"was reset as it got torque: {', '.join(differing)}"
                        for place, differing in lost.items()
                    },
                    "Is its supply strong enough? Look where the joint is, and enable again.",
                )
            waiting = {place: values for place, values in waiting.items() if place not in read}
            yield
        raise stubborn(link, {place: ["no answer"] for place in waiting})

    def _tells_of_a_reset(self, place: int) -> bool:
        """Whether what is read of a servo now and then shows that it was reset."""
        state = self._link.states[place]
        level = state.values.get("status_return_level")
        in_ram = state.has("status_return_level") and not state.table["status_return_level"].eeprom
        return bool(state.values.get("bus_watchdog")) or (in_ram and level != LEVEL_AT_START)

    def _check_counts(self, before: Mapping[int, int], here: Mapping[int, int]) -> None:
        """Make sure that servos count as before.

        Raises:
            DeviceFault: one does not: it was a turn further, or its modes differ by a homing offset.
        """
        for place, count in here.items():
            servo = self._link.chain.servos[place]
            if abs(count - before.get(place, count)) > servo.units.model.family.counts // 4:
                raise DeviceFault(
                    f"{servo.place} counts {count} after the change of its mode, and {before[place]} before",
                    where=self._link.address,
                    remedy="Its position is not what it was. A homing offset beyond a quarter of a turn does "
                    "that: calibrate. Look where the joint is, and enable again.",
                )

    def _still(self, place: int, kind: Kind, count: int) -> dict[str, int]:
        """Return what the RAM of a servo at a count must hold before torque goes on, its goal included.

        Raises:
            DeviceFault: it is where it takes no goal, and would jump.
        """
        if kind is Kind.POSITION:
            raise_first(self.beyond({place: count}))
        link = self._link
        state, servo = link.states[place], link.chain.servos[place]
        wanted: dict[str, int] = {n: state.values[n] for n in KEPT if n in state.values}
        settings = registers.ram(servo, state.table, self._config, state.values)
        wanted |= {s.item.name: s.value for s in settings if not s.item.eeprom}
        for bound, limit in _BOUNDS:
            if limit in state.values and state.has(bound):
                # What it was before, by another configuration or mode, would bound the other modes.
                _, most = state.table.item(bound).range
                wanted.setdefault(bound, min(state.values[limit], most))
        wanted[self.goal_register(place, kind)] = count if kind is Kind.POSITION else 0
        return {name: value for name, value in wanted.items() if state.has(name)}
