"""An OnRobot vacuum gripper by its registers: no joint, but channels that grip, release and tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

from typing_extensions import override

from crtk_driver_onrobot.config import LEAST_VACUUM, MOST_VACUUM, OnRobotConfig
from crtk_driver_onrobot.device import Talk
from crtk_driver_onrobot.models import PER_MILLE, Vacuum
from crtk_driver_onrobot.registers import Command, Status
from crtk_drivers.commands import Payload
from crtk_drivers.device import Answer as Told
from crtk_drivers.device import Capabilities, Mode, Note, Reading, Severity, StopPolicy
from crtk_drivers.errors import TransitionFailed
from crtk_drivers.kit import until
from crtk_drivers.kit.gripping import Adjustable, Doing, Hand, HandService, Measured
from crtk_drivers.samples import Flag, Number, Text, Value

__all__ = ["VacuumHand"]

TOLD: Final = 1.0
"""Seconds in which a command must be acknowledged."""
LETS_GO: Final = 0.5
"""Share of `held_from` below which a channel holds nothing any more."""
_FIRST: Final = (Doing.HOLDS, Doing.EVACUATING, Doing.RELEASING, Doing.UNKNOWN)
"""What of its channels is told of all of it."""

_BELOW: Final = {
    Doing.HOLDS: Doing.LOST,
    Doing.RELEASING: Doing.FREE,
    Doing.UNKNOWN: Doing.FREE,
}
"""What becomes of it when the vacuum is gone."""


class Channel:
    """Follows one channel; no I/O.

    Args:
        held_from: Pa from which it holds something.
    """

    def __init__(self, held_from: float) -> None:
        self._held_from = held_from
        self.begin()

    def begin(self) -> None:
        """A connection begins."""
        self.vacuum = 0.0
        self.doing = Doing.UNKNOWN

    def told(self, *, grips: bool) -> None:
        """A command was acknowledged."""
        self.doing = Doing.EVACUATING if grips else Doing.RELEASING

    def see(self, vacuum: float) -> None:
        """Take what was measured, in Pa."""
        self.vacuum = vacuum
        if vacuum >= self._held_from and self.doing is not Doing.RELEASING:
            self.doing = Doing.HOLDS
        elif vacuum < LETS_GO * self._held_from:
            self.doing = _BELOW.get(self.doing, self.doing)
        elif self.doing is Doing.UNKNOWN:
            self.doing = Doing.FREE


class VacuumHand(Hand):
    """One gripper."""

    fault = None

    def __init__(self, config: OnRobotConfig) -> None:
        assert isinstance(config.tool, Vacuum)
        self._tool = config.tool
        self._talk = Talk(config)
        text = f"vacuum of the next grips in Pa, {LEAST_VACUUM:.0f} to {MOST_VACUUM:.0f}"
        limits = LEAST_VACUUM, MOST_VACUUM
        self._vacuum = Adjustable("vacuum", text, config.vacuum, lambda: limits, "Pa")
        self._channels = {name: Channel(config.held_from) for name in self._tool.channels}
        self._pending: dict[Command, tuple[tuple[str, ...], bool]] = {}
        self._taken: Command | None = None
        self.capabilities = Capabilities(
            model=config.data.title,
            measured=(),
            rate=config.rate,
            stop=StopPolicy(0.0, "keeps its vacuum as long as it has power"),
        )

    @property
    @override
    def where(self) -> str:
        return self._talk.where

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return self._talk.counters

    @property
    @override
    def is_open(self) -> bool:
        return self._talk.status is not None

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self._pending.clear()
        for channel in self._channels.values():
            channel.begin()
        self._see(self._talk.open(deadline, given_up))

    @override
    def close(self, *, moves: bool) -> None:
        self._talk.close()

    @override
    def exchange(self, deadline: float) -> Measured | None:
        answer = self._talk.exchange(next(iter(self._pending), None), deadline)
        if answer is None:
            return None
        told = self._pending.pop(answer.delivered, None) if answer.delivered else None
        if told is not None:
            self._taken, (names, grips) = answer.delivered, told
            for name in names:
                self._channels[name].told(grips=grips)
        self._see(answer.status)
        return Measured(answer.stamp)

    def _see(self, status: Status) -> None:
        for at, channel in enumerate(self._channels.values(), self._tool.status.address):
            channel.see(PER_MILLE * status.words[at])

    def _order(self, names: tuple[str, ...], *, grips: bool) -> Command:
        percent = round(0.1 * self._vacuum.value / PER_MILLE)
        word = self._tool.grip | percent if grips else self._tool.release
        address = self._tool.channels.index(names[0])
        command = Command(address, word.to_bytes(2, "big") * len(names))
        self._pending[command] = names, grips
        return command

    @override
    def order(self, mode: Mode, value: float, ratio: float) -> None:
        raise NotImplementedError

    @override
    def go(self, order: object, *, at_once: bool) -> None:
        raise NotImplementedError

    @override
    def halt(self, *, aside: bool) -> None:
        """Nothing moves; what is held is held on, and what has waited is not sent."""
        self._pending.clear()

    @override
    def let_go(self) -> None:
        self._order(self._tool.channels, grips=False)

    @property
    @override
    def is_told(self) -> bool:
        return not self._pending

    @property
    @override
    def rests(self) -> bool:
        return True

    @property
    @override
    def doing(self) -> Doing:
        found = {channel.doing for channel in self._channels.values()}
        return next((doing for doing in _FIRST if doing in found), Doing.FREE)

    # ------------------------------------------------------------------------------------ beyond CRTK

    @property
    @override
    def services(self) -> Mapping[str, HandService]:
        whole = self._tool.channels
        groups = {"": whole, **{f"_{name}": (name,) for name in whole}}
        found = dict(self._talk.services(empty=True))
        for end, names in groups.items():
            what = "all channels" if names is whole else f"channel {names[0]}"
            grip, release = partial(self._told, names, True), partial(self._told, names, False)
            found[f"grip{end}"] = HandService(f"build up vacuum in {what}", grip)
            found[f"release{end}"] = HandService(f"release {what}", release)
        return found

    def _told(self, names: tuple[str, ...], grips: bool) -> Told:
        what = "grip" if grips else "release"
        command = self._order(names, grips=grips)
        try:
            is_told = yield from until(lambda: command not in self._pending, TOLD)
        finally:
            self._pending.pop(command, None)  # given up, it is not carried out later
        if is_told and self._taken is not command:
            text = f"{what} was broken off by a stop, before it was acknowledged"
            raise TransitionFailed(text, where=self.where, remedy="Ask for it again.")
        if not is_told:
            raise TransitionFailed(
                f"{what} was not acknowledged in {TOLD:g} s",
                where=self.where,
                remedy="See what its link says.",
            )
        return f"{what}: channel {', '.join(names)}"

    @property
    @override
    def adjustables(self) -> tuple[Adjustable, ...]:
        return (self._vacuum,)

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        found = {"tool": Reading("which one is there", Payload.TEXT, self._talk.tell_tool)}
        for name, channel in self._channels.items():
            what = f"channel {name}"
            tell: tuple[tuple[str, str, Payload, Callable[[Channel], Value]], ...] = (
                ("vacuum", "Pa below ambient in", Payload.NUMBER, lambda x: Number(x.vacuum)),
                ("holds", "an object in", Payload.FLAG, lambda x: Flag(x.doing is Doing.HOLDS)),
                ("grip", "what is done by", Payload.TEXT, lambda x: Text(x.doing)),
            )
            for key, text, payload, of in tell:
                found[f"{key}_{name}"] = Reading(
                    f"{text} {what}", payload, partial(self._tell, channel, of)
                )
        return found

    def _tell(self, channel: Channel, of: Callable[[Channel], Value]) -> Value | None:
        return of(channel) if self.is_open and channel.doing is not Doing.UNKNOWN else None

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        return tuple(
            Note(Severity.WARNING, f"channel {name}", "what it held is gone")
            for name, channel in self._channels.items()
            if channel.doing is Doing.LOST
        )
