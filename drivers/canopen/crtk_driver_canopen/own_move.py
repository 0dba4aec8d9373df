"""A move that the drives of an arm plan themselves (profile position), until its end."""

from __future__ import annotations

from dataclasses import dataclass

from crtk_drivers.device import Goal, MoveProgress
from crtk_drivers.errors import MotionAborted

__all__ = ["OwnMove"]


@dataclass(eq=False)
class OwnMove:
    """A move of the drives' own.

    Attributes:
        goal: positions (n,) and ratios.
        failure: why it ended before its goal; empty if it did not.
        done: whether all drives are there.
    """

    goal: Goal
    failure: str = ""
    done: bool = False

    @property
    def waits(self) -> bool:
        """Whether it has not come to an end."""
        return not self.done and not self.failure

    def progress(self, where: str) -> MoveProgress:
        """Say where it stands.

        Args:
            where: the arm, for messages.

        Raises:
            MotionAborted: it has ended before its goal, and why.
        """
        if self.failure:
            raise MotionAborted(
                f"the drives ended move_jp: {self.failure}",
                where=where,
                remedy="Look at the drives, and send it again.",
            )
        return MoveProgress.DONE if self.done else MoveProgress.RUNNING
