"""What comes in pieces, without end, or beside the point: the device alone, at a pipe, a file, a socket."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
import termios
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest

from crtk_driver_inputs.config import InputsConfig
from crtk_driver_inputs.device import ANSWERED, ASK_PERIOD, InputsDevice
from crtk_driver_inputs.events import EVENT
from crtk_drivers.samples import Joy
from rigs.beside import beside
from rigs.waiting import eventually

SHORT = 5.0
PRESSED = Joy(buttons=(1,))
RELEASED = Joy(buttons=(0,))
ANSWER = struct.pack("@i", 0x7FAA5501)
THERE = struct.pack("@8i", 0x7FAA2005, 2, *(0,) * 6)
PRESS = struct.pack("@8i", 1, 3, *(0,) * 6)


def pushed_up(device: InputsDevice) -> float:
    device.read(soon())
    return float(device.readings["joy"].tell().axes[2])


def soon() -> float:
    return time.monotonic() + SHORT


def clutch(device: InputsDevice) -> Any:
    device.read(soon())
    return device.readings["clutch"].tell()


def test_what_was_told_with_missing_events_is_older_than_what_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "event0"
    os.mkfifo(path)
    device = InputsDevice(InputsConfig(path=str(path), pedals={"clutch": 30}))
    with path.open("r+b", buffering=0) as kernel:
        device.open(soon())
        kernel.write(EVENT.pack(0, 0, 1, 30, 1))
        assert clutch(device) == PRESSED
        press = EVENT.pack(0, 0, 1, 30, 1)
        kernel.write(EVENT.pack(0, 0, 0, 3, 0) + press + EVENT.pack(0, 0, 0, 0, 0))
        assert clutch(device) == RELEASED, "of a pipe nothing can be asked for"
        kernel.write(EVENT.pack(0, 0, 1, 30, 7))
        assert clutch(device) == RELEASED, "7 is no press"
        device.close()


@pytest.mark.timeout(20)
def test_a_device_that_tells_without_end_is_left_at_the_deadline_and_not_known() -> None:
    device = InputsDevice(InputsConfig(path="/dev/zero", pedals={"clutch": 30}))
    device.open(soon())
    device.read(time.monotonic() + 0.02)
    assert device.readings["clutch"].tell() == Joy(buttons=(0,), is_valid=False)
    device.close()


def taken(peer: socket.socket) -> None:
    """Wait until the other end has read all."""
    eventually(
        lambda: struct.unpack("i", fcntl.ioctl(peer, termios.TIOCOUTQ, b"\0" * 4)) == (0,),
        "read",
        SHORT,
    )


def whole(peer: socket.socket) -> None:
    peer.sendall(ANSWER + PRESS)


def cut(peer: socket.socket) -> None:
    peer.sendall(ANSWER[:1])
    taken(peer)
    peer.sendall(ANSWER[1:] + PRESS)


def behind_an_event(peer: socket.socket) -> None:
    peer.sendall(PRESS + ANSWER)


def long_behind_an_event(peer: socket.socket) -> None:
    peer.sendall(PRESS)
    taken(peer)
    peer.sendall(ANSWER)


@pytest.mark.parametrize("answer", [whole, cut, behind_an_event, long_behind_an_event])
def test_the_answer_of_spacenavd_comes_in_any_way(
    tmp_path: Path, answer: Callable[[socket.socket], None]
) -> None:
    path = str(tmp_path / "s")
    asked: list[bytes] = []
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen(1)

        def daemon(_: threading.Event) -> None:
            with listener.accept()[0] as peer:
                peer.recv(4)
                answer(peer)
                asked.append(peer.recv(32))
                peer.sendall(struct.pack("@8i", 0, 100, 200, 300, 0, 0, 0, 1))
                with suppress(ConnectionResetError, BrokenPipeError):  # it has closed
                    while peer.recv(32):
                        peer.sendall(THERE)

        device = InputsDevice(InputsConfig(link="spacenavd", path=path, pedals={"clutch": 3}))
        with beside(daemon), closing(device):
            device.open(soon())
            eventually(lambda: clutch(device) == PRESSED, "the button", SHORT)
            eventually(lambda: pushed_up(device) > 0.8, "z of the mouse", SHORT)
    assert struct.unpack_from("@i", asked[0]) == (0x7FAA2005,)


def test_a_button_of_a_daemon_that_stands_still_is_not_known(tmp_path: Path) -> None:
    """Whoever was on it may have let go."""
    path = str(tmp_path / "s")
    runs = threading.Event()
    questions: list[bytes] = []
    enough = ANSWERED / ASK_PERIOD + 1.0
    runs.set()
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen(1)

        def daemon(_: threading.Event) -> None:
            with listener.accept()[0] as peer, suppress(ConnectionResetError, BrokenPipeError):
                peer.recv(4)
                peer.sendall(ANSWER + PRESS)
                while runs.wait(SHORT) and (asked := peer.recv(32)):
                    questions.append(asked)
                    peer.sendall(THERE)

        device = InputsDevice(InputsConfig(link="spacenavd", path=path, pedals={"clutch": 3}))
        with beside(daemon), closing(device):
            device.open(soon())
            eventually(lambda: clutch(device) == PRESSED, "it is pressed", SHORT)
            eventually(
                lambda: clutch(device) == PRESSED and len(questions) > enough, "it still is", SHORT
            )
            runs.clear()
            eventually(lambda: not clutch(device).is_valid, "nothing is known", SHORT)
            runs.set()
            eventually(lambda: clutch(device) == PRESSED, "it answers again", SHORT)
