"""What servos need before they are given torque: a restart after an error, and EEPROM as configured."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

from crtk_driver_dynamixel import registers
from crtk_driver_dynamixel.chain_link import ChainLink
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.replies import ServoCorrupt, ServoRefused, ServoSilent
from crtk_driver_dynamixel.servo_state import KEPT, Values
from crtk_drivers.device import Steps
from crtk_drivers.errors import TransitionFailed, raise_first

ATTEMPTS: Final = 10
"""Times that something is tried until a servo has done it."""
REBOOT_TIME: Final = 3.0
"""Seconds in which a restarted servo answers again."""


def recover(link: ChainLink, places: Sequence[int]) -> Steps:
    """Wait for all servos that are silent, and restart those that report an error, once.

    Raises:
        TransitionFailed: one stays silent, or has its error still.
    """
    yield from _heard(link, places)
    broken = [place for place in places if link.health[place].hardware_error]
    for place in broken:
        _reboot(link, place)
    if broken:
        yield
        yield from _heard(link, broken)
    errors = [
        f"{link.chain.servos[p].place}: {text}"
        for p in places
        if (text := link.health[p].error_text)
    ]
    if errors:
        raise TransitionFailed(
            "; ".join(errors),
            where=link.address,
            remedy="It is there after a restart, too: check supply, load and temperature.",
        )


def _heard(link: ChainLink, places: Sequence[int]) -> Steps:
    """Read how servos are, until each has answered.

    Raises:
        TransitionFailed: one does not.
    """
    end = time.monotonic() + REBOOT_TIME
    while True:
        answered = link.read_health(places)
        places = [place for place in places if place not in answered]
        if not places:
            return
        if time.monotonic() >= end:
            break
        yield
    raise unheard(link, ", ".join(link.chain.servos[place].place for place in places))


def unheard(link: ChainLink, names: str) -> TransitionFailed:
    """Return what to say of servos that do not answer."""
    text = f"{names} does not answer"
    return TransitionFailed(text, where=link.address, remedy="Check its power and cable.")


def _reboot(link: ChainLink, place: int) -> None:
    servo = link.chain.servos[place]
    try:
        if servo.units.model.family.restarts:
            link.reboot(place)
            return
    except ServoRefused:
        pass  # it should know it, and does not
    except (ServoSilent, ServoCorrupt):
        return  # it may have heard: `recover` looks
    raise _lasting(link, place)


def _lasting(link: ChainLink, place: int) -> TransitionFailed:
    """Return what to say of an error that no restart removes."""
    servo = link.chain.servos[place]
    return TransitionFailed(
        f"{servo.place}: {link.health[place].error_text}; a {servo.units.model.name} knows no restart",
        where=link.address,
        remedy="Support the arm, switch the supply of the servo off and on, and enable again.",
    )


def obstacles(
    link: ChainLink, unset_of: Mapping[int, Mapping[str, int]], config: DynamixelConfig
) -> Iterator[TransitionFailed]:
    """Yield what `recover` and `set_up` fail on, by the registers as they were read last.

    Args:
        link: of the chain.
        unset_of: what is `unset`, of each servo that is asked for.
        config: of the chain.
    """
    for place, wanted in unset_of.items():
        state, servo = link.states[place], link.chain.servos[place]
        if link.health[place].hardware_error and not servo.units.model.family.restarts:
            yield _lasting(link, place)
        yield from _unfit(link, place, wanted)
        if wanted:
            torque = link.health[place].torque
            is_on = bool(state.values.get("torque_enable")) if torque is None else torque
            yield from _unwritable(link, place, wanted, config, torque=is_on)


def set_up(link: ChainLink, places: Sequence[int], config: DynamixelConfig) -> Steps:
    """Read what may have changed, and write the EEPROM where it differs.

    The operating mode is left as it is: it changes together with goals and torque.

    Raises:
        TransitionFailed: with what is in the way.
    """
    for place in places:
        yield from _refresh(link, place)
        yield
        wanted = unset(link, place, config)
        raise_first(_unfit(link, place, wanted))
        if wanted:
            yield from _write_eeprom(link, place, wanted, config)
            yield


def unset(link: ChainLink, place: int, config: DynamixelConfig) -> dict[str, int]:
    """Return what the EEPROM of a servo must hold and does not, by register."""
    state, servo = link.states[place], link.chain.servos[place]
    first = link.chain.servos[link.chain.of_joint(servo.joint)[0]]
    settings = registers.eeprom(
        servo,
        first,
        state.table,
        config,
        link.placement.calibrated.get((servo.bus, servo.id)),
    )
    return {
        setting.item.name: setting.written(state.values[setting.item.name])
        for setting in settings
        if setting.differs(state.values[setting.item.name])
        and setting.item.name != "operating_mode"
    }


def _unfit(link: ChainLink, place: int, wanted: Values) -> Iterator[TransitionFailed]:
    """Yield what keeps a servo from what the configuration promises, once `wanted` is written."""
    servo = link.placement.configured.servos[place]
    found = registers.obstacles(servo, {**link.states[place].values, **wanted})
    if found:
        yield TransitionFailed("; ".join(found), where=link.address)


def _refresh(link: ChainLink, place: int) -> Steps:
    state = link.states[place]
    kept: dict[str, int] = {n: state.values[n] for n in KEPT if n in state.values}
    yield from _insist(lambda: link.refresh(state))
    link.placement.has_other_registers(place)
    state.values.update(kept)  # what it had before it lost its power, if it did


def _insist(action: Callable[[], None]) -> Steps:
    """Do something with one servo again until it answers.

    Raises:
        TransitionFailed: it never does, or says no.
    """
    for attempt in range(ATTEMPTS):
        try:
            action()
        except (ServoSilent, ServoCorrupt, ServoRefused) as error:
            if isinstance(error, ServoRefused) or attempt == ATTEMPTS - 1:
                raise TransitionFailed(
                    error.message, where=error.where, remedy=error.remedy
                ) from error
            yield
        else:
            return


def _unwritable(
    link: ChainLink, place: int, wanted: Values, config: DynamixelConfig, *, torque: bool
) -> Iterator[TransitionFailed]:
    """Yield why registers of a servo cannot be written."""
    name, state = link.chain.servos[place].place, link.states[place]
    described = ", ".join(f"{r} {state.values[r]} to {value}" for r, value in wanted.items())
    if not config.write_eeprom:
        yield TransitionFailed(
            f"{name} is not set up: {described}",
            where=link.address,
            remedy="Set write_eeprom to true, or write it with a tool of your own.",
        )
    elif torque:
        yield TransitionFailed(
            f"{name} must be changed ({described}), which its torque forbids",
            where=link.address,
            remedy="Support the arm, send disable, and enable again.",
        )


def _write_eeprom(link: ChainLink, place: int, wanted: Values, config: DynamixelConfig) -> Steps:
    name, state = link.chain.servos[place].place, link.states[place]
    torque = bool(state.values.get("torque_enable"))
    raise_first(_unwritable(link, place, wanted, config, torque=torque))
    yield from _insist(lambda: link.write_checked(place, wanted))
    refused = [register for register, value in wanted.items() if state.values[register] != value]
    if refused:
        raise TransitionFailed(
            f"{name} did not take {', '.join(refused)}",
            where=link.address,
            remedy="Look at these registers with DYNAMIXEL Wizard.",
        )
