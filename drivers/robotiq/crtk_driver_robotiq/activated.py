"""What a Robotiq gripper of any kind must have before it does anything: an activation (rACT)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, Final, Generic, NamedTuple, TypeVar

from typing_extensions import override

from crtk_drivers.device import Answer, Steps
from crtk_drivers.errors import CrtkError, TransitionFailed
from crtk_drivers.kit import until
from crtk_drivers.kit.gripping import Echo, Hand, HandService, Weight, When, not_made_ready

__all__ = ["TURN", "ActivatedHand", "Turn"]

TURN: Final = 2.0
"""Seconds in which a command must show."""

CommandT = TypeVar("CommandT")


class Turn(NamedTuple):
    """A part of an activation.

    Attributes:
        command: that is sent; None: what was sent before goes on.
        shows: whether it is carried out.
        timeout: s in which it must be.
        what: it does then, for messages.
    """

    command: Any
    shows: Callable[[], bool]
    timeout: float
    what: str


class ActivatedHand(Hand, Generic[CommandT]):
    """One gripper.

    Attributes:
        drops: what an activation does, for people.
        hint: what to do where it does not come to its end.
    """

    drops: ClassVar[str]
    hint: ClassVar[str]

    def __init__(self, policy: str) -> None:
        self._policy = policy
        self._pending: CommandT | None = None
        self._activating = False

    @abstractmethod
    def _turns(self) -> Iterator[Turn]:
        """Return what an activation has to go through now, one after the other."""

    @property
    @abstractmethod
    def _echo(self) -> Echo[CommandT]:
        """Whose command it echoes."""

    @property
    @override
    def taken_over(self) -> bool:
        return self._echo.taken_over

    @property
    @override
    def is_others(self) -> bool:
        return self._echo.is_others

    @property
    @override
    def is_in_doubt(self) -> bool:
        return self._echo.is_in_doubt

    @property
    @override
    def is_told(self) -> bool:
        return self._pending is None

    @override
    def obstacles(self, *, may_hold: bool) -> tuple[CrtkError, ...]:
        fault, policy = self.fault, self._policy
        if policy == "always" or not self._must_be_activated:
            return ()
        what = "it is not activated" if fault is None else fault.text
        return not_made_ready(
            what, policy, "activate", may_hold=may_hold, where=self.where, verb="activate it"
        )

    @property
    def _must_be_activated(self) -> bool:
        fault = self.fault
        must_reset = fault is not None and fault.weight is Weight.RESET
        return must_reset or self.unfit(enabled=False) is not None

    @override
    def make_ready(self, *, may_hold: bool) -> Steps:
        if self._must_be_activated or self._policy == "always":
            yield from self._activate()

    def _activate(self) -> Steps:
        """Reset it if it must be, and activate it."""
        self._activating = True
        try:
            for turn in self._turns():
                yield from self._take(turn)
        finally:
            self._activating = False
            self._pending = None  # given up, it is not carried out later, and stopped by a reset

    def _take(self, turn: Turn) -> Steps:
        if turn.command is not None:
            self._pending = turn.command
        done = yield from until(lambda: self._pending is None and turn.shows(), turn.timeout)
        if not done:
            fault = self.fault
            why = f": {fault.text}" if fault else ""
            raise TransitionFailed(
                f"it did not {turn.what} in {turn.timeout:g} s{why}",
                where=self.where,
                remedy=fault.remedy if fault else self.hint,
            )

    @property
    @override
    def services(self) -> Mapping[str, HandService]:
        return {"activate": HandService(self.drops, self._activated, When.NOT_ENABLED)}

    def _activated(self) -> Answer:
        yield from self._activate()
        return "activated"
