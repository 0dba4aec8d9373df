"""A runtime for scripts under test: pure built-ins, sync and sleep, and log(value)."""

from __future__ import annotations

from typing import Any

from crtk_sim_backends.ur.program.running import ProgramRuntime
from crtk_sim_backends.ur.urscript import (
    PURE_BUILTINS,
    Builtin,
    compile_program,
    copy_value,
    timing_builtins,
)

TICK = 0.002


def start(text: str, log: list[Any], *extra: Builtin) -> ProgramRuntime:
    """Compile and start a script whose log(value) appends to ``log``."""

    def write(value: Any) -> None:
        log.append(copy_value(value))

    builtins = {**PURE_BUILTINS, **timing_builtins(TICK), "log": Builtin("log", write)}
    builtins |= {builtin.name: builtin for builtin in extra}
    runtime = ProgramRuntime(compile_program(text, builtins), TICK)
    runtime.start()
    return runtime


def run(text: str, *extra: Builtin, ticks: int = 100) -> list[Any]:
    """Run a script to its end, which must come within ``ticks``, and return what it logged."""
    log: list[Any] = []
    runtime = start(text, log, *extra)
    for _ in range(ticks):
        runtime.step()
        if runtime.finished:
            return log
    raise AssertionError(f"still running after {ticks} ticks: {log}")
