"""Runs the programs of a controller: one that may move the arm, and secondary ones beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

from crtk_sim_backends.ur.clock import Clock
from crtk_sim_backends.ur.messages import (
    ErrorMessage,
    KeyMessage,
    Message,
    ReportLevel,
    RuntimeExceptionMessage,
)
from crtk_sim_backends.ur.motion.plant import Plant
from crtk_sim_backends.ur.program.running import ProgramRuntime
from crtk_sim_backends.ur.safety.modes import RobotMode, RuntimeState, SafetyMode
from crtk_sim_backends.ur.urscript import (
    Builtin,
    ScriptError,
    available,
    compile_program,
    dialect_of,
)
from crtk_sim_backends.ur.versions import Version

RAMP_SECONDS: Final = 0.2  # for speed scaling to go from nothing to full, s
FORCES: Final = "external_force_torque"
FORCE_FREQUENCY: Final = 10.0  # Hz, in which they have to come (manual, ft_rtde_input_enable)
SECONDARY_LIMIT: Final = 16  # secondary programs at a time

_STEPPED: Final = (RuntimeState.PLAYING, RuntimeState.PAUSING, RuntimeState.RESUMING)


class Robot(Protocol):
    """What runs programs.

    Attributes:
        version: of the software.
        clock: of the controller.
        plant: the mechanics.
    """

    version: Version
    clock: Clock
    plant: Plant

    @property
    def robot_mode(self) -> RobotMode:
        """How far the arm is powered."""

    @property
    def safety_mode(self) -> SafetyMode:
        """The safety mode that shows."""

    @property
    def can_play(self) -> bool:
        """Whether power and safety permit a program to run."""

    def post(self, message: Message) -> None:
        """Send a message to the clients."""


@dataclass
class _Next:
    """A program that takes another's place, once the end of that one was shown for a control period."""

    runtime: ProgramRuntime
    name: str
    end_shown: bool = False


@dataclass
class _Watchdog:
    period: float
    action: str
    kicked: float


class ProgramPlayer:
    """Plays, pauses and stops programs, and watches over the RTDE inputs that they wait for.

    Attributes:
        state: of the program; a new one is STOPPED.
        name: of the running or last program, "" before the first.
        failed: whether a runtime error or the safety system has ended the last one.
        ended: what is called when the running program ends.
        thread_ended: what is called with the owner (see `caller`) of motions when its thread ends.
        pause_factor: speed scaling by pause: 1 while playing, 0 when paused.
        has_watchdogs: whether those that programs ask for are kept.
        pauses_on: code and argument (None: any) of the errors at which the running program wants a pause.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._clock = robot.clock
        self._builtins: Mapping[str, Builtin] = {}
        self._dialect = dialect_of(robot.version)
        self._program: ProgramRuntime | None = None
        self._next: _Next | None = None
        self._secondary: list[ProgramRuntime] = []
        self._stepping: ProgramRuntime | None = None
        self.has_watchdogs = True
        self._watchdogs: dict[str, _Watchdog] = {}
        self._default_watchdog: _Watchdog | None = None  # of measured forces
        self.pauses_on: set[tuple[int, int | None]] = set()
        self.state: RuntimeState = RuntimeState.STOPPED
        self.name = ""
        self.failed = False
        self.ended: list[Callable[[], None]] = []
        self.thread_ended: list[Callable[[object], None]] = []
        self.pause_factor = 1.0

    @property
    def loaded(self) -> bool:
        """Whether a program plays or is paused, or is about to."""
        return self._program is not None or self._next is not None

    @property
    def running(self) -> ProgramRuntime | None:
        """The program that plays or is paused."""
        return self._program

    def set_builtins(self, builtins: Mapping[str, Builtin]) -> None:
        """Give the functions that programs can call, if the controller's software has them."""
        self._builtins = available(builtins, self._robot.version)

    def caller(self) -> tuple[ProgramRuntime, int]:
        """Thread that runs now, for built-ins. Raises RuntimeError outside a program's step."""
        runtime = self._stepping
        if runtime is None or runtime.current_thread is None:
            raise RuntimeError("a built-in was called outside a running program")
        return runtime, runtime.current_thread

    def prepare(self, text: str) -> None:
        """Compile a script ahead, in any thread, so that `run` need not wait for it."""
        self.check(text)

    def check(self, text: str) -> ScriptError | None:
        """What is wrong with a script; None when it can be run."""
        try:
            compile_program(text, self._builtins, self._dialect)
        except ScriptError as error:
            return error
        return None

    def run(self, text: str) -> None:
        """Run a script; what is wrong with it becomes a message."""
        try:
            program = compile_program(text, self._builtins, self._dialect)
        except ScriptError as error:
            self._report(error)
            return
        robot = self._robot
        runtime = ProgramRuntime(program, self._clock.dt)
        runtime.on_thread_end = lambda handle: self._end_thread((runtime, handle))
        if program.kind == "sec":
            if len(self._secondary) >= SECONDARY_LIMIT:
                self._warn(f"{program.name} refused: {SECONDARY_LIMIT} secondary programs run")
                return
            self._secondary.append(runtime)
            runtime.start()
            return
        replaces = self._program is not None or self._next is not None
        self.end()
        if not robot.can_play:
            state = f"{robot.robot_mode.name}, {robot.safety_mode.name}"
            self._warn(f"Program {program.name} refused: robot is {state}")
            return
        if replaces:
            self._next = _Next(runtime, program.name)
        else:
            self._start(runtime, program.name)

    def _end_thread(self, owner: tuple[ProgramRuntime, int]) -> None:
        for tell in self.thread_ended:
            tell(owner)

    def _start(self, runtime: ProgramRuntime, name: str) -> None:
        self._program = runtime
        self.name = name
        self.state = RuntimeState.PLAYING
        self.failed = False
        self._robot.post(KeyMessage("PROGRAM_XXX_STARTED", name))
        runtime.start()

    def _start_next(self) -> None:
        following = self._next
        if following is None:
            return
        if not following.end_shown:
            following.end_shown = True
            return
        self._next = None
        if self._robot.can_play:
            self._start(following.runtime, following.name)

    def step(self) -> None:
        """Let every program run for one control period."""
        self._start_next()
        if self._watchdogs:
            self._check_watchdogs()
        if self._program is not None and self.state in _STEPPED:
            self._step(self._program)
        for secondary in tuple(self._secondary):
            self._step(secondary)

    def _step(self, runtime: ProgramRuntime) -> None:
        self._stepping = runtime
        try:
            runtime.step()
        except ScriptError as error:
            self.failed = self.failed or runtime is self._program
            if runtime.program.kind == "sec":
                self._robot.post(KeyMessage("SECONDARY_PROGRAM_EXCEPTION_XXX", error.text))
            else:
                self._report(error)
        finally:
            self._stepping = None
        if runtime.finished:
            if runtime is self._program:
                self.end()
            elif runtime in self._secondary:
                self._secondary.remove(runtime)

    def ramp(self) -> None:
        """Bring the speed scaling towards what pause or play ask for, for one control period."""
        pausing = self.state in (RuntimeState.PAUSING, RuntimeState.PAUSED)
        step = self._clock.dt / RAMP_SECONDS
        self.pause_factor = ramp(self.pause_factor, 0.0 if pausing else 1.0, step)

    def settle(self) -> None:
        """Finish transitions that wait for the arm."""
        if self.state == RuntimeState.STOPPING:
            if not self._robot.plant.arm.moving:
                self.state = RuntimeState.STOPPED
        elif self.state == RuntimeState.PAUSING:
            if self.pause_factor == 0.0:
                self.state = RuntimeState.PAUSED
        elif self.state == RuntimeState.RESUMING and self.pause_factor == 1.0:
            self.state = RuntimeState.PLAYING

    def pause(self) -> bool:
        """Pause the running program; False when none plays."""
        if self.state not in (RuntimeState.PLAYING, RuntimeState.RESUMING):
            return False
        self.state = RuntimeState.PAUSING
        return True

    def resume(self) -> bool:
        """Go on with the paused program; False when none is paused."""
        if self.state not in (RuntimeState.PAUSED, RuntimeState.PAUSING):
            return False
        self.state = RuntimeState.RESUMING
        for watchdog in self._watchdogs.values():
            watchdog.kicked = self._clock.time
        return True

    def end(self, *, failed: bool = False) -> None:
        """Stop the program, let the arm slow down, leave what only a program can hold."""
        self._next = None
        runtime = self._program
        if runtime is None:
            return
        self.failed = self.failed or failed
        plant = self._robot.plant
        arm = plant.arm
        self._program = None
        runtime.stop()
        self._watchdogs.clear()
        self.pauses_on.clear()
        plant.end_modes()
        # The arm slows down from its present speed; the pause no longer counts.
        arm.plan_qd = [v * self.pause_factor for v in arm.plan_qd]
        self.pause_factor = 1.0
        self.state = RuntimeState.STOPPING if arm.moving else RuntimeState.STOPPED
        self._robot.post(KeyMessage("PROGRAM_XXX_STOPPED", self.name))
        for tell in self.ended:
            tell()

    def end_all(self) -> None:
        """Stop the program and the secondary ones."""
        self.end()
        for secondary in self._secondary:
            secondary.stop()
        self._secondary.clear()

    # Watchdogs.

    def set_watchdog(self, variable: str, frequency: float, action: str) -> None:
        """Expect RTDE input `variable` at `frequency`, Hz; 0 ends the watch."""
        if frequency <= 0.0 or not self.has_watchdogs:
            self._watchdogs.pop(variable, None)
        else:
            time = self._clock.time
            self._watchdogs[variable] = _Watchdog(1.0 / frequency, action, time)

    def watch_forces(self, on: bool) -> None:
        """Expect measured forces ten times a second, where a program has set no watchdog itself."""
        if on and self._program is not None and not self._watchdogs:
            self.set_watchdog(FORCES, FORCE_FREQUENCY, "pause")
            self._default_watchdog = self._watchdogs.get(FORCES)
        elif not on and self._watchdogs.get(FORCES) is self._default_watchdog:
            self._watchdogs.pop(FORCES, None)

    def written(self, variable: str) -> None:
        """Tell that an RTDE input has been written."""
        if variable in self._watchdogs:
            self._watchdogs[variable].kicked = self._clock.time

    def _check_watchdogs(self) -> None:
        time = self._clock.time
        late = [
            (name, watchdog)
            for name, watchdog in self._watchdogs.items()
            if time - watchdog.kicked > watchdog.period + 0.5 * self._clock.dt
        ]
        for name, watchdog in late:
            watchdog.kicked = time
            if watchdog.action == "ignore" or self.state != RuntimeState.PLAYING:
                continue
            self._warn(f"RTDE watchdog: {name} was not written for {watchdog.period:g} s")
            if watchdog.action == "stop":
                self.end()
            else:
                self.pause()

    def _report(self, error: ScriptError) -> None:
        self._robot.post(RuntimeExceptionMessage(error.line, error.column, error.text))

    def _warn(self, text: str) -> None:
        self._robot.post(ErrorMessage(0, 0, ReportLevel.WARNING, text))


def ramp(value: float, goal: float, step: float) -> float:
    """Move `value` towards `goal` by at most `step`; what rounding leaves of the way is gone as well."""
    if abs(goal - value) <= step * (1.0 + 1e-9):
        return goal
    return value + step if value < goal else value - step
