"""Commands for people: what it is and does, and where its fingers end."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

from pydantic import Field
from rich.console import Console

from crtk_driver_robotiq.config import RobotiqConfig
from crtk_driver_robotiq.faults import fault_of
from crtk_driver_robotiq.finding import GRIPPERS
from crtk_driver_robotiq.ft300.finding import SENSORS
from crtk_driver_robotiq.registers import COUNTS, Activation, Command, Contact, Status
from crtk_drivers.config import Settings
from crtk_drivers.errors import ConnectionFailed, TransitionFailed
from crtk_drivers.errors.wording import worded
from crtk_drivers.plugins import Tool

__all__ = ["TOOLS"]

SWEEP: Final = 15.0
"""Seconds that the slowest way from end to end may take."""
SLOW: Final = 64
"""Count of the speed."""
LAG: Final = 0.3
"""Seconds after a command before gOBJ is believed."""


class CalibrateOptions(Settings):
    """Options of ``calibrate``."""

    move: bool = Field(
        default=False, description="Let it move: it opens, closes and opens. Nothing may be held."
    )


class _Talk:
    """An open link, asked until it answers."""

    def __init__(self, config: RobotiqConfig) -> None:
        from crtk_driver_robotiq.device import make_link

        self._config = config
        self._link = make_link(config)

    def __enter__(self) -> _Talk:
        self._link.open(time.monotonic() + self._config.open_timeout)
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()

    def ask(self, command: Command | None = None) -> Status:
        """Send a command, if there is one, and return the status."""
        deadline = time.monotonic() + self._config.open_timeout
        sent = command
        while time.monotonic() < deadline:
            answer = self._link.exchange(sent, deadline)
            if answer is not None and (command is None or answer.delivered is command):
                return answer.status
        text, remedy = self._link.trouble
        raise ConnectionFailed(text, where=self._link.where, remedy=remedy)

    def until(self, test: Callable[[Status], bool], what: str) -> Status:
        """Ask until a status passes a test."""
        deadline = time.monotonic() + SWEEP
        while not test(status := self.ask()):
            if time.monotonic() > deadline:
                raise TransitionFailed(f"it did not {what}", where=self._link.where)
            time.sleep(0.01)
        return status

    def go(self, position: int) -> Status:
        """Go to an end, slowly, with the least force."""
        self.ask(Command(go=True, position=position, speed=SLOW))
        time.sleep(LAG)
        return self.until(lambda status: status.contact is not Contact.MOVING, "come to rest")


def _info(config: RobotiqConfig, options: Any) -> int:
    with _Talk(config) as talk:
        status = talk.ask()
    fault = fault_of(status)
    rows = {
        "model (as configured)": config.data.title,
        "activation": status.activation.name.lower().replace("_", " "),
        "position (gPO)": f"{status.position} of {config.open_count} (open) to {config.closed_count}",
        "asked for (gPR)": f"{status.requested}, {'goes' if status.goes else 'does not go'} there",
        "object (gOBJ)": status.contact.name.lower().replace("_", " "),
        "current": "not told" if status.current is None else f"{status.current:.2f} A",
        "fault": "none" if fault is None else f"{fault.text}. {fault.remedy}",
    }
    console = Console(highlight=False)
    for name, value in rows.items():
        console.print(f"{name:<24}{value}")
    return 0


def _calibrate(config: RobotiqConfig, options: CalibrateOptions) -> int:
    console = Console(highlight=False)
    if not options.move:
        console.print("It opens, closes and opens again: take out what it holds, then add --move.")
        return 2
    with _Talk(config) as talk:
        if talk.ask().activation is not Activation.DONE:
            console.print("It is not activated: enable it first.")
            return 1
        opened, closed = talk.go(0), talk.go(COUNTS)
        again = talk.go(0)
    if any(status.contact is not Contact.AT_REQUEST for status in (opened, closed, again)):
        console.print("It met something on its way: take that out, and try again.")
        return 1
    console.print(f"open_count = {max(opened.position, again.position)}")
    console.print(f"closed_count = {closed.position}")
    return 0


def _scan(config: RobotiqConfig, options: Any) -> int:
    console = Console(highlight=False)
    if config.link in ("controller", "urcap"):
        console.print(f"What is at link {config.link} is not looked for: ask it by `info`.")
        return 1
    places = _places(config)
    if not places:
        console.print("There is no serial adapter; give a --port, or a --host with its --link.")
    found = 0
    for place in places:
        console.print(f"{place}:", soft_wrap=True)
        for plugin, finder in (("robotiq", GRIPPERS), ("robotiq-ft300", SENSORS)):
            for device in finder.look(place):
                found += 1
                settings = device.settings.items()
                given = " ".join(f"--{key.replace('_', '-')} {value}" for key, value in settings)
                command = worded(f"crtk-driver {plugin} {given}")
                console.print(f"  {device.told}\n    {command}", soft_wrap=True)
    if places and not found:
        console.print("Nobody answers.")
    return 0 if found else 1


def _places(config: RobotiqConfig) -> list[str]:
    """Return where to look: where the configuration says, or at all adapters."""
    if config.link == "serial":
        return [config.port] if config.port else list(GRIPPERS.places())
    scheme = "modbus" if config.link == "modbus" else "socket"
    return [f"{scheme}://{config.host}:{config.number}"] if config.host else []


TOOLS: Final = (
    Tool(
        "scan",
        "looks for grippers and force sensors at a port, or at all serial adapters",
        _scan,
        check_real=lambda config: None,
    ),
    Tool("info", "tells what it reports; nothing is written", _info),
    Tool(
        "calibrate",
        "measures the positions at which it is open and closed; it moves",
        _calibrate,
        CalibrateOptions,
    ),
)
