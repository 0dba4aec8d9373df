"""What a controller is asked when it is connected, and refused for."""

from __future__ import annotations

from crtk_driver_galil.commander import Commander
from crtk_driver_galil.config import GalilConfig, JointConfig
from crtk_driver_galil.record import AXES, LAYOUTS, Layout, layout_of
from crtk_driver_galil.replies import numbers
from crtk_drivers.errors import DeviceError, ProtocolError

__all__ = ["Examination"]

REVISION = "\x12\x16"
SAMPLE_TIME = 1000
"""µs of a sample (TM)."""


class Examination:
    """Questions to a controller that was just connected, each of which waits for its answer.

    Args:
        commander: to it.
        config: what it should be.
        deadline: monotonic s of all answers.
    """

    def __init__(self, commander: Commander, config: GalilConfig, deadline: float) -> None:
        self._commander = commander
        self._config = config
        self._deadline = deadline

    def ask(self, command: str) -> str:
        """Return the answer to a command; see `Commander.ask`."""
        return self._commander.ask(command, self._deadline)

    def revision(self) -> str:
        """Return what it calls itself; from now on it repeats no commands."""
        self.ask("EO 0")
        self.ask("CW 1")  # what programs write is told from answers by its highest bits
        return self.ask(REVISION)

    def layout(self, revision: str) -> Layout:
        """Return how its records are laid out.

        Raises:
            DeviceError: nobody says.
        """
        if self._config.model != "auto":
            return LAYOUTS[self._config.model]
        layout = layout_of(revision)
        if layout is None:
            raise DeviceError(
                f"the data record of this controller is not known: it calls itself {revision!r}",
                where=self._commander.where,
                remedy=f"If it is like that of a known family, give `model`: {', '.join(LAYOUTS)}.",
            )
        return layout

    def axes(self, layout: Layout) -> int:
        """Return how many axes it has.

        Raises:
            DeviceError: it has others, or another record, than is believed.
        """
        answer = self.ask("QZ")
        try:
            count, *_, size = (int(each) for each in numbers(answer))
        except ValueError as error:
            raise ProtocolError(
                f"QZ was answered with {answer!r}", where=self._commander.where
            ) from error
        if size != layout.axis_size:
            raise DeviceError(
                f"an axis has {size} bytes in its data record (QZ), not {layout.axis_size} as with the "
                f"family {layout.name}",
                where=self._commander.where,
                remedy="Give the right `model`, or leave it out.",
            )
        letters = [joint.axis for joint in self._config.joints.values()]
        missing = [letter for letter in letters if AXES.index(letter) >= count]
        if missing:
            raise DeviceError(
                f"it has the axes {AXES[:count]}, and not {', '.join(missing)}",
                where=self._commander.where,
                remedy="Correct `axis` of the joints.",
            )
        return count

    def _number(self, operand: str) -> int:
        """Return a whole number of the controller."""
        answer = self.ask(f"MG {operand}")
        try:
            return round(numbers(answer)[0])
        except (ValueError, OverflowError) as error:
            raise ProtocolError(
                f"MG {operand} was answered with {answer!r}", where=self._commander.where
            ) from error

    def check_samples(self) -> None:
        """Refuse other samples than of a millisecond, in which periods are sent and times come."""
        time = self._number("_TM")
        if time != SAMPLE_TIME:
            raise DeviceError(
                f"its samples take {time} µs (TM), not {SAMPLE_TIME}",
                where=self._commander.where,
                remedy=f"Send TM {SAMPLE_TIME}, and tune the axes for it.",
            )

    def watch_position(self, name: str, joint: JointConfig) -> None:
        """Let the axis switch itself off when it is too far from where it should be, and read that back."""
        counts = max(1, round(joint.following / joint.scale))
        for command, value in (("ER", counts), ("OE", 1)):
            self.ask(f"{command}{joint.axis}={value}")
            held = self._number(f"_{command}{joint.axis}")
            if held != value:
                raise DeviceError(
                    f"joint {name}: {command} of axis {joint.axis} was set to {value}, and is {held}",
                    where=self._commander.where,
                    remedy="Check in the manual what it takes; `following_error` of the joint sets it.",
                )
