"""Scenarios with a toy device, for the tests of what runs worlds, reduces findings and tells stories.

The toy answers datagrams. Its driver has a mistake that needs two troubles at a time: while nothing comes, it
finds that its wall clock was set.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
from datetime import datetime
from pathlib import Path
from typing import Final

from crtk_drivers.testing.world import World

TROUBLES: Final = 10
_PERIOD: Final = 0.01
_SILENCE: Final = 0.005
_SECONDS: Final = 1.0


def quiet(world: World, _device: str = "toy") -> None:
    """End at once."""
    world.say("nothing happens")


def dates(world: World, zone: str) -> list[str]:
    """Return what the clock on the wall says, wherever the machine is."""
    world.say(f"the machine is in {zone}")
    return [datetime.now().isoformat(), time.strftime("%Y-%m-%d %H:%M:%S %Z")]


def broken(world: World, _device: str = "toy") -> None:
    """Ask the toy for a second, with ten troubles meanwhile."""
    for _ in range(TROUBLES):
        world.troubles.around(0.8 * _SECONDS, chance=1.0)
    toy = world.start("toy", _answer)
    driver = threading.Thread(target=_drive, args=(world,), name="io toy")
    driver.start()
    driver.join()
    world.kernel.end_process(toy, 0)


def hangs(_world: World, pipe: str = "pipe") -> None:
    """Wait for the real system, which is not patched here: nobody ever writes into the pipe."""
    if not Path(pipe).exists():
        os.mkfifo(pipe)
    Path(pipe).read_text()


def _answer() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as toy:
        toy.bind(("127.0.0.1", 5005))
        while True:
            question, whose = toy.recvfrom(100)
            toy.sendto(question, whose)


def _drive(world: World) -> None:
    began = time.time() - time.monotonic()
    was_set = False
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(_SILENCE)
        end = time.monotonic() + _SECONDS
        while time.monotonic() < end:
            link.sendto(b"?", ("127.0.0.1", 5005))
            try:
                link.recv(100)
                is_silent = False
            except TimeoutError:
                is_silent = True
            if not was_set and abs(time.time() - time.monotonic() - began) > 1.0:
                was_set = True
                logging.getLogger("toy").warning("the clock was set")
            if is_silent and was_set:
                world.find("the toy is lost", "nothing came\nand the clock was set")
            time.sleep(_PERIOD)


def break_at_once() -> None:
    """Plant another mistake: the driver takes any answer for none."""
    globals()["_drive"] = lambda world: world.find("the toy is lost", "it always is")


def wanders(world: World, _device: str = "toy") -> None:
    """Fail by the last of three troubles, and meet four more where one of the others is left out."""
    for _ in range(3):
        world.troubles.around(0.01, chance=1.0)
    time.sleep(0.02)
    struck = [line.text[:3] for line in world.story]
    for _ in range(4 if len(struck) < 3 else 0):
        world.troubles.around(0.01, chance=1.0)
    time.sleep(0.02)
    if "[2]" in struck:
        world.find("the toy is lost", "by one trouble")
