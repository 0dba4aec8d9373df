"""The simulated tracker: its modes, port handles, frames and faults. No socket, and a clock that is given.

One state for all clients, as the hardware has it: whoever stops tracking stops it for everybody.
"""

from __future__ import annotations

import math
import random
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from crtk_sim_backends.faults import Fault
from crtk_sim_backends.ndi import frames, wire
from crtk_sim_backends.ndi.defects import TrackerDefects
from crtk_sim_backends.ndi.families import FREQUENCY, STEPS, Family
from crtk_sim_backends.ndi.frames import Seen
from crtk_sim_backends.ndi.handles import INITIALISED, Handle, make_rom
from crtk_sim_backends.ndi.injection import HIDDEN, KINDS
from crtk_sim_backends.ndi.motion import ERROR, Motion, Place, is_inside, place, shaken
from crtk_sim_backends.ndi.plugs import Sensor
from crtk_sim_backends.ndi.track import Play, Track

MOST_HANDLES: Final = 32

COLD, SETUP, TRACKING = "cold", "setup", "tracking"
_ANY: Final = frozenset({COLD, SETUP, TRACKING})
_READY: Final = frozenset({SETUP, TRACKING})
_IN_SETUP: Final = frozenset({SETUP})
_IN_TRACKING: Final = frozenset({TRACKING})

BAUDS: Final = (9600, 14400, 19200, 38400, 57600, 115200, 921600, 1228739)
SERIAL: Final = "P7-{:05d}"

_H: Final = "[0-9A-Fa-f]"
_OPTIONS: Final = f"({_H}{{4}})?"

Answer = str | bytes | int
"""Text, the body of a binary reply, or the code of an error."""


class Tracker:
    """One tracker.

    Args:
        family: what it is.
        wired: sensors of its wired tools.
        motion: of its tools.
        noise: in mm.
        left: how many of its wired tools a client that died has left initialised.
        defects: of what it tells.
        clock: monotonic seconds.
        wall: ns since the epoch.
        strays: how many markers it sees that belong to no tool.
        latency: seconds from when a frame is taken until it is told.
        frequency: value of its parameter `FREQUENCY`, until a client sets another one.

    Attributes:
        baud: of its serial line, in bit/s.
        on_reset: called when it was reset.
    """

    def __init__(
        self,
        family: Family,
        wired: Sequence[Sensor],
        motion: Motion,
        noise: float,
        left: int,
        defects: TrackerDefects,
        clock: Callable[[], float],
        wall: Callable[[], int],
        strays: int = 0,
        latency: float = 0.0,
        frequency: str = "2",
    ) -> None:
        self.kinds = KINDS
        self.family = family
        self.baud = BAUDS[0]
        self.on_reset: Callable[[], object] = lambda: None
        self._wired = list(wired)
        self._motion, self._noise, self._defects = motion, noise, defects
        self._clock, self._wall = clock, wall
        self._strays = [(-50.0, 30.0 * each, family.middle) for each in range(1, strays + 1)]
        self._latency = latency
        self._frequency = frequency
        self._questions = 0
        """For a frame, since it was switched on."""
        self._moved: dict[str, tuple[Track, Play]] = {}  # by part number
        self._mode = COLD
        self._handles: dict[int, Handle] = {}
        self._origin = 0.0
        self._volume = 1
        self._faults: dict[str, Mapping[str, Any]] = {}
        self._replies = 0
        self._until = 0
        """Commands until the one that the fault `message` meets."""
        self._told_frame = -1
        self._commands = self._table()
        if left:
            self._plug_in()
            for handle in list(self._handles.values())[:left]:
                handle.initialised = True

    # ------------------------------------------------------------------------------- for the simulator

    def begin(self, fault: Fault) -> None:
        """Let a fault of its own begin."""
        if fault.kind == "reset":
            self._reset()
            self.on_reset()
        elif fault.kind == "stop_tracking":
            self._mode = SETUP if self._mode == TRACKING else self._mode
        else:
            self._faults[fault.kind] = fault.parameters
            if fault.kind == "message":
                self._until = fault.parameters["number"]
            if fault.kind == "frozen":
                self._faults["frozen"] = {"frame": self._number()}

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._faults.pop(fault.kind, None)

    def status(self) -> Mapping[str, Any]:
        """What a test or a person wants to know."""
        return {
            "mode": self._mode,
            "frame": self._number() if self._mode == TRACKING else -1,
            "origin": self._origin,
            "rate": self.family.rate,
            "step": STEPS[self._frequency],
            "questions": self._questions,
            "baud": self.baud,
            "handles": " ".join(f"{h.number:02X}:{h.status:02X}" for h in self._handles.values()),
        }

    def put(
        self, part_number: str, ns: int, position: Sequence[float], orientation: Sequence[float]
    ) -> None:
        """Let a tool be somewhere from a time on, instead of on its path.

        Args:
            part_number: of the tool.
            ns: when it was there, since the epoch.
            position: x, y, z in m, in the frame of the tracker.
            orientation: quaternion x, y, z, w.

        Raises:
            ValueError: this is no pose.
        """
        numbers = (*position, *orientation)
        if len(position) != 3 or len(orientation) != 4 or not all(map(math.isfinite, numbers)):
            raise ValueError(f"{numbers} is no pose: x, y, z in m, quaternion x, y, z, w")
        if not abs(math.hypot(*orientation) - 1.0) < 1e-3:
            raise ValueError(f"the length of {orientation} is not 1")
        x, y, z = (1e3 * coordinate for coordinate in position)
        qx, qy, qz, q0 = orientation
        if part_number not in self._moved:
            self._moved[part_number] = Track(), Play(self._defects.play, part_number)
        track, _ = self._moved[part_number]
        track.put(ns, Place(x, y, z, q0, qx, qy, qz, ERROR))

    def fate(self, line: bytes) -> Mapping[str, Any] | None:
        """Return what becomes of this command or its reply by the fault `message`; None: nothing."""
        fault = self._faults.get("message")
        if fault is None or fault["command"] not in ("", wire.parse(line).name):
            return None
        self._until -= 1
        return None if self._until else fault

    def obey(self, line: bytes) -> bytes:
        """Carry out one command, and return the reply to it."""
        command = wire.parse(line)
        forced = self._faults.get("error")
        if forced is not None and forced["command"] in ("", command.name):
            return wire.error(forced["code"])
        if self._faults.get("swallow", {}).get("command") in ("", command.name):
            return b""
        answer = wire.words("WARNING06") if self._warns(command.name) else self._answer(command)
        return self._spoilt(answer)

    def _warns(self, name: str) -> bool:
        return self._faults.get("warning", {}).get("command") == name

    def _answer(self, command: wire.Command) -> bytes:
        found = self._commands.get(command.name)
        if command.damaged:
            return wire.error(0x04)
        if found is None or (command.name == "BX2" and not self.family.bx2):
            return wire.error(0x01)
        modes, pattern, run = found
        if self._mode not in modes:
            return wire.error(0x10 if self._mode == COLD else 0x0C)
        if not re.fullmatch(pattern, command.arguments):
            return wire.error(0x07)
        answer = run(command.arguments)
        if isinstance(answer, int):
            return wire.error(answer)
        if isinstance(answer, str):
            return wire.words(answer)
        hostile = self._faults.get("hostile_length")
        if hostile is not None:
            return struct.pack("<HI", 0xA5C8, hostile["size"]) + answer
        return wire.binary(answer, self.family.long_replies and command.name == "BX2")

    def _spoilt(self, reply: bytes) -> bytes:
        damage = self._faults.get("damage")
        self._replies += 1
        if damage is None or self._replies % damage["every"]:
            return reply
        middle = len(reply) // 2
        return reply[:middle] + bytes([reply[middle] ^ 0x55]) + reply[middle + 1 :]

    # ---------------------------------------------------------------------------------------- handles

    def _reset(self) -> None:
        self._mode, self.baud = COLD, BAUDS[0]
        self._handles.clear()

    def _allot(self, handle: Handle) -> int:
        self._handles[handle.number] = handle
        return handle.number

    def _free_number(self) -> int:
        return next((n for n in range(1, MOST_HANDLES + 1) if n not in self._handles), 0)

    def _plug_in(self) -> None:
        """Give handles to wired tools that have none; some trackers one after the other."""
        unplugged = self._faults.get("unplug", {}).get("tool")
        for tool, sensor in enumerate(self._wired):
            present = [h for h in self._handles.values() if h.wired and h.tool == tool]
            if sensor.port - 1 == unplugged:
                for handle in present:
                    del self._handles[handle.number]
                continue
            if not present:
                kind = 1 if "REF" in sensor.part_number.upper() else 2
                handle = Handle(self._free_number(), tool, wired=True)
                if sensor.part_number:
                    rom = make_rom(sensor.part_number, kind)
                    handle.memory[: len(rom)] = rom
                handle.serial_number = sensor.serial_number
                handle.port, handle.channel = sensor.port, sensor.channel
                present = [self._handles[self._allot(handle)]]
            if self.family.one_by_one and not present[0].initialised:
                return

    def _ports(self, which: str) -> Answer:
        if self._mode == SETUP:
            self._plug_in()
        tests: Mapping[str, Callable[[Handle], bool]] = {
            "00": lambda h: True,
            "01": lambda h: h.wired and h.port - 1 == self._faults.get("unplug", {}).get("tool"),
            "02": lambda h: not h.initialised,
            "03": lambda h: h.initialised and not h.enabled,
            "04": lambda h: h.enabled,
        }
        found = [h for h in self._handles.values() if tests[which](h)]
        return f"{len(found):02X}" + "".join(f"{h.number:02X}{h.status:03X}" for h in found)

    def _handle(self, digits: str) -> Handle | None:
        return self._handles.get(int(digits, 16))

    def _free(self, digits: str) -> Answer:
        return "OKAY" if self._handles.pop(int(digits, 16), None) else 0x08

    def _request(self, arguments: str) -> Answer:
        if self.family.indicator:
            return 0x2F  # an Aurora has no port for what hangs on no wire
        if not (number := self._free_number()):
            return 0x2D
        wireless = [h.tool for h in self._handles.values() if not h.wired]
        tool = max([len(self._wired) - 1, *wireless]) + 1
        return f"{self._allot(Handle(number, tool, wired=False)):02X}"

    def _write_memory(self, arguments: str) -> Answer:
        handle, address = self._handle(arguments[:2]), int(arguments[2:6], 16)
        data = bytes.fromhex(arguments[6:])
        if handle is None:
            return 0x08
        if address + len(data) > len(handle.memory) or address % len(data):
            return 0x23
        handle.memory[address : address + len(data)] = data
        return "OKAY"

    def _initialise_port(self, digits: str) -> Answer:
        handle = self._handle(digits)
        if handle is None or handle.initialised or handle.is_empty or not handle.is_sound:
            if handle is None:
                return 0x08
            return 0x13 if handle.initialised else 0x2C if handle.is_empty else 0x40
        handle.initialised = True
        return "OKAY"

    def _enable_port(self, arguments: str) -> Answer:
        handle = self._handle(arguments[:2])
        if handle is None or not handle.initialised:
            return 0x08 if handle is None else 0x0E
        if arguments[2] not in "SDB":
            return 0x09
        handle.enabled = True
        return "OKAY"

    def _disable_port(self, digits: str) -> Answer:
        handle = self._handle(digits)
        if handle is None:
            return 0x08
        handle.enabled = False
        return "OKAY"

    def _port_information(self, arguments: str) -> Answer:
        handle = self._handle(arguments[:2])
        if handle is None:
            return 0x08
        return (
            handle.information(int(arguments[2:] or "0001", 16))
            if handle.wired or not handle.is_empty
            else "UNOCCUPIED"
        )

    # ----------------------------------------------------------------------------------------- modes

    def _reset_command(self, arguments: str) -> Answer:
        self._reset()
        return "RESET"

    def _initialise(self, arguments: str) -> Answer:
        """Tools that were initialised stay so: what a client that died has left."""
        self._mode = SETUP
        return "OKAY"

    def _communicate(self, arguments: str) -> Answer:
        digit = int(arguments[0], 16)
        if digit >= len(BAUDS) or arguments[1:3] != "00":
            return 0x06
        self.baud = BAUDS[digit]
        return "OKAY"

    def _start(self, arguments: str) -> Answer:
        self._mode, self._origin, self._told_frame = TRACKING, self._clock(), -1
        return "OKAY"

    def _stop(self, arguments: str) -> Answer:
        self._mode = SETUP
        return "OKAY"

    def _version(self, arguments: str) -> Answer:
        if arguments == "5":
            return self.family.version
        if arguments not in ("0", "3", "4"):
            return self.family.version_error
        return self.family.told(SERIAL.format(12345))

    def _get(self, name: str) -> Answer:
        parameters = {
            "Features.Hardware.Model": self.family.model,
            "Features.Hardware.Serial Number": SERIAL.format(12345),
            "Features.Firmware.API Revision": self.family.api,
            "Param.Tracking.Selected Volume": f"{self._volume - 1}",
            FREQUENCY: self._frequency,
        }
        if not self.family.model:
            return 0x01
        return f"{name}={parameters[name]}" if name in parameters else 0x34

    def _set(self, assignment: str) -> Answer:
        name, _, value = assignment.partition("=")
        if name != FREQUENCY or not self.family.model or self.family.indicator:
            return 0x34 if self.family.model else 0x01
        return self._set_frequency(value)

    def _set_frequency(self, value: str) -> Answer:
        if value not in STEPS or self.family.indicator:
            return 0x36
        self._frequency = value
        return "OKAY"

    def _select_volume(self, number: str) -> Answer:
        if number not in ("1", "2"):
            return 0x24
        self._volume = int(number)
        return "OKAY"

    def _table(self) -> Mapping[str, tuple[frozenset[str], str, Callable[[str], Answer]]]:
        """Return by name in which modes a command may come, what its arguments look like, what it does."""
        return {
            "RESET": (_ANY, ".*", self._reset_command),
            "INIT": (frozenset({COLD, SETUP}), "", self._initialise),
            "COMM": (frozenset({COLD, SETUP}), f"{_H}\\d{{4}}", self._communicate),
            "ECHO": (_ANY, ".*", lambda text: text),
            "VER": (_ANY, ".+", self._version),
            "APIREV": (_ANY, "", lambda text: self.family.api or 0x01),
            "GET": (_ANY, ".+", self._get),
            "SFLIST": (_ANY, f"{_H}{{2}}", lambda text: "2" if self.family.indicator else "1"),
            "VSEL": (_IN_SETUP, ".", self._select_volume),
            "SET": (_IN_SETUP, ".+=.+", self._set),
            "IRATE": (_IN_SETUP, "[0-2]", self._set_frequency),
            "BEEP": (_READY, "[1-9]", lambda text: "1"),
            "LED": (_READY, f"{_H}{{2}}..", lambda text: "OKAY"),
            "PHSR": (_READY, "0[0-4]", self._ports),
            "PHF": (_IN_SETUP, f"{_H}{{2}}", self._free),
            "PHRQ": (_IN_SETUP, r"[*\w]{9}1[*\w]{4}", self._request),
            "PVWR": (_IN_SETUP, f"{_H}{{6}}{_H}{{128}}", self._write_memory),
            "PINIT": (_IN_SETUP, f"{_H}{{2}}", self._initialise_port),
            "PENA": (_IN_SETUP, f"{_H}{{2}}.", self._enable_port),
            "PDIS": (_IN_SETUP, f"{_H}{{2}}", self._disable_port),
            "PHINF": (_READY, f"{_H}{{2}}{_OPTIONS}", self._port_information),
            "TSTART": (_IN_SETUP, f"({_H}{{2}})?", self._start),
            "TSTOP": (_IN_TRACKING, "", self._stop),
            "TX": (_IN_TRACKING, _OPTIONS, self._tx),
            "BX": (_IN_TRACKING, _OPTIONS, self._bx),
            "BX2": (_IN_TRACKING, ".*", self._bx2),
        }

    # ----------------------------------------------------------------------------------------- frames

    def _number(self) -> int:
        frozen = self._faults.get("frozen")
        if frozen is not None and "frame" in frozen:
            return int(frozen["frame"])
        number = max(0, int((self._clock() - self._origin - self._latency) * self.family.rate))
        return number - number % STEPS[self._frequency]

    def _taken(self, number: int) -> int:
        """Return when a frame was taken, in ns since the epoch."""
        age = self._clock() - self._origin - number / self.family.rate
        return self._wall() - round(age * 1e9)

    def _seen(self, number: int) -> list[Seen]:
        found = []
        hidden = None if self._defects.tells_covered else self._faults.get("hide")
        pressed = self._faults.get("press")
        taken = self._taken(number)
        for handle in self._handles.values():
            at = self._place(handle, number, taken)
            bit, port = 0, handle.status
            shown = told = None
            if at is not None:
                told = self._told(at)
                bit = 0 if is_inside(self.family, at) else 6
                shown = told if bit == 0 or abs(at.z) < abs(self.family.far) + 1000.0 else None
            if hidden is not None and hidden["tool"] in (handle.tool, -1):
                bit = HIDDEN[hidden["how"]]
                shown = None if hidden["how"] == "missing" else told
            elif self._misses(handle.tool, number):
                shown = None
            if pressed is not None and pressed["tool"] == handle.tool:
                port |= 1 << pressed["button"]
            if handle.initialised and handle.enabled:
                found.append(Seen(handle.number, shown, bit, port, enabled=True))
            elif handle.initialised:
                found.append(Seen(handle.number, None, 0, port | INITIALISED, enabled=False))
        return found

    def _place(self, handle: Handle, number: int, taken: int) -> Place | None:
        """Return where a tool is seen; None: what moves it has not told where it is."""
        moved = self._moved.get(handle.part_number)
        if moved is None:
            at: Place | None = place(self.family, self._motion, handle.tool, number)
        else:
            track, play = moved
            at = track.at(taken)
            at = None if at is None else play.at(at)
        return None if at is None else shaken(at, handle.tool, number, self._noise)

    def _told(self, at: Place) -> Place:
        scale = self._defects.scale
        return at._replace(x=scale * at.x, y=scale * at.y, z=scale * at.z)

    def _misses(self, tool: int, number: int) -> bool:
        missing = self._defects.missing
        return missing > 0.0 and random.Random(f"{tool} {number}").random() < missing

    @property
    def _system(self) -> int:
        return int(self._faults.get("system", {}).get("bits", 0))

    def _tx(self, arguments: str) -> Answer:
        self._questions += 1
        number, options = self._number(), int(arguments or "0001", 16)
        return frames.tx(self._seen(number), number, self._system, options, self._strays)

    def _bx(self, arguments: str) -> Answer:
        self._questions += 1
        number, options = self._number(), int(arguments or "0001", 16)
        return frames.bx(self._seen(number), number, self._system, options, self._strays)

    def _bx2(self, arguments: str) -> Answer:
        """Nothing where the frame has been told."""
        self._questions += 1
        number = self._number()
        seen = self._seen(number) if number != self._told_frame else []
        self._told_frame = number
        strays = self._strays if "--3d=strays" in arguments or "--3d=all" in arguments else ()
        magnetic, strange = self.family.indicator, "strange" in self._faults
        return frames.bx2(seen, number, self._taken(number), magnetic, strange, strays)
