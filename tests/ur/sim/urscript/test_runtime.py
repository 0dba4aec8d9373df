"""Threads of a running program: order, kill and join, halt, stop, and who runs now."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import pytest

from crtk_sim_backends.ur.program.running import ProgramRuntime
from crtk_sim_backends.ur.urscript import Builtin, ScriptRuntimeError, compile_program
from rigs.urscript_runtime import TICK, run, start


def steps(runtime: ProgramRuntime, log: list[Any], count: int) -> list[list[Any]]:
    """Step a program and return what it logged in each tick."""
    ticks = []
    for _ in range(count):
        log.clear()
        runtime.step()
        ticks.append(log.copy())
    return ticks


def test_threads_run_in_creation_order_and_new_ones_in_the_same_tick() -> None:
    script = """
    def f():
      thread inner():
        while True:
          log("inner")
          sync()
        end
      end
      thread outer():
        log("start")
        run inner()
        while True:
          log("outer")
          sync()
        end
      end
      run outer()
      while True:
        log("main")
        sync()
      end
    end
    """
    log: list[Any] = []
    first, second = steps(start(script, log), log, 2)
    assert first == ["main", "start", "outer", "inner"]
    assert second == ["main", "outer", "inner"]


def test_nothing_runs_before_the_first_step() -> None:
    log: list[Any] = []
    runtime = start("log(1)\nsync()", log)
    assert log == []
    assert not runtime.finished
    runtime.step()
    assert log == [1]
    runtime.step()
    assert runtime.finished


def test_a_program_starts_once() -> None:
    runtime = start("sync()", [])
    with pytest.raises(RuntimeError, match="already started"):
        runtime.start()


def test_threads_take_arguments_by_value() -> None:
    script = """
    def f():
      thread t(q, n=2):
        q[0] = q[0] + n
        log(q)
      end
      a = [1]
      run t(a)
      run t(a, n=5)
      a[0] = 100
      sync()
      log(a)
    end
    """
    assert run(script) == [[3], [6], [100]]


def test_kill_ends_a_thread_where_it_waits() -> None:
    script = """
    def f():
      global n = 0
      thread t():
        while True:
          n = n + 1
          sync()
        end
      end
      h = run t()
      sync()
      sync()
      kill h
      log(n)
      sync()
      log(n)
      kill h
    end
    """
    # Main runs first in each tick: at its third tick the thread has run twice.
    assert run(script) == [2, 2]


@pytest.mark.parametrize("handle", ["0", "99", "-1"])
def test_kill_and_join_of_no_thread_do_no_harm(handle: str) -> None:
    assert run(f"kill {handle}\njoin {handle}\nlog(1)", ticks=2) == [1]


def test_a_thread_may_kill_itself() -> None:
    script = """
    def f():
      global h = 0
      def leave():
        kill h
      end
      thread t():
        leave()
        log("never")
      end
      h = run t()
      join h
      log("joined")
    end
    """
    assert run(script, ticks=2) == ["joined"]


def test_join_goes_on_in_the_tick_after_the_end_of_a_later_thread() -> None:
    script = """
    def f():
      thread short():
        sync()
        log("short ends")
      end
      h = run short()
      join h
      log("joined")
      join h
      log("again")
    end
    """
    log: list[Any] = []
    assert steps(start(script, log), log, 4) == [[], ["short ends"], ["joined"], ["again"]]


def test_a_function_that_joins_blocks_its_caller() -> None:
    script = """
    def f():
      thread short():
        sync()
        log("short ends")
      end
      def wait_for(h):
        join h
        return "waited"
      end
      log(wait_for(run short()))
    end
    """
    log: list[Any] = []
    assert steps(start(script, log), log, 3) == [[], ["short ends"], ["waited"]]


def test_a_thread_can_join_an_earlier_one_in_the_same_tick() -> None:
    script = """
    def f():
      thread first():
        sync()
        log("first ends")
      end
      thread second(h):
        join h
        log("joined")
      end
      run second(run first())
      sleep(1)
    end
    """
    log: list[Any] = []
    assert steps(start(script, log), log, 2) == [[], ["first ends", "joined"]]


def test_handles_are_true_in_a_comparison_with_zero_and_never_reused() -> None:
    script = """
    def f():
      thread t():
      end
      a = run t()
      join a
      b = run t()
      log(a != 0 and b != 0 and a != b)
    end
    """
    assert run(script) == [True]


def test_the_program_ends_with_its_main_thread() -> None:
    script = """
    def f():
      thread t():
        while True:
          log("t")
          sync()
        end
      end
      run t()
      sync()
    end
    """
    log: list[Any] = []
    runtime = start(script, log)
    assert steps(runtime, log, 3) == [["t"], [], []]
    assert runtime.finished


@pytest.mark.parametrize("where", ["def", "thread"])
def test_halt_ends_everything_at_once(where: str) -> None:
    script = f"""
    def f():
      def stop_all():
        halt
      end
      thread t():
        {"stop_all()" if where == "thread" else "sync()"}
        log("t")
      end
      thread late():
        log("late")
      end
      run t()
      run late()
      {"stop_all()" if where == "def" else "sync()"}
      log("main")
    end
    """
    assert run(script, ticks=1) == []


def test_a_critical_section_is_not_interrupted() -> None:
    script = """
    def f():
      global a = 0
      global b = 0
      global differed = False
      thread t():
        while True:
          enter_critical
          differed = differed or a != b
          a = a + 1
          b = b + 1
          exit_critical
          sync()
        end
      end
      run t()
      run t()
      i = 0
      while i < 10:
        enter_critical
        differed = differed or a != b
        exit_critical
        sync()
        i = i + 1
      end
      log([a, b, differed])
    end
    """
    assert run(script) == [[20, 20, False]]


def test_a_secondary_program_runs_beside_another() -> None:
    log: list[Any] = []
    primary = start("def f():\n while True:\n  log(1)\n  sync()\n end\nend", log)
    secondary = start("sec s():\n log(2)\nend", log)
    assert secondary.program.kind == "sec"
    for _ in range(2):
        primary.step()
        secondary.step()
    assert log == [1, 2, 1]
    assert secondary.finished


def test_blocking_functions_return_values_through_any_number_of_calls() -> None:
    def measure(n: int) -> Generator[None, None, int]:
        for _ in range(n):
            yield
        return n * 10

    script = """
    def f():
      def inner(n):
        return measure(n) + 1
      end
      def outer(a, b):
        if inner(a) > 10 and inner(b) > 10:
          return [inner(a), inner(b)]
        end
      end
      log(outer(1, b=2))
    end
    """
    log: list[Any] = []
    runtime = start(script, log, Builtin("measure", measure, blocking=True))
    assert steps(runtime, log, 7) == [[]] * 6 + [[[11, 21]]]


def test_the_current_thread_is_known_to_builtins_and_ends_are_told() -> None:
    callers: list[int | None] = []
    ended: list[int] = []
    runtime: ProgramRuntime

    def who() -> None:
        callers.append(runtime.current_thread)

    script = """
    def f():
      thread t(n):
        sleep(n)
        who()
      end
      a = run t(0.002)
      b = run t(0.004)
      c = run t(10)
      who()
      join a
      join b
      kill c
      sync()
    end
    """
    runtime = start(script, [], Builtin("who", who))
    runtime.on_thread_end = ended.append
    while not runtime.finished:
        runtime.step()
        assert runtime.current_thread is None
    assert callers == [1, 2, 3]
    assert ended == [2, 3, 4, 1]


def test_stop_closes_what_builtins_hold_open() -> None:
    closed: list[int] = []

    def hold(n: int) -> Generator[None]:
        try:
            while True:
                yield
        finally:
            closed.append(n)

    script = "def f():\n thread t():\n  hold(2)\n end\n run t()\n hold(1)\nend"
    runtime = start(script, [], Builtin("hold", hold, blocking=True))
    runtime.step()
    held = list(runtime._threads.values())  # so that nobody but stop() closes them
    runtime.stop()
    assert closed == [1, 2]
    assert len(held) == 2
    assert runtime.finished
    runtime.step()
    runtime.stop()
    assert closed == [1, 2]


def test_a_builtin_may_stop_the_program_that_calls_it() -> None:
    log: list[Any] = []
    ended: list[int] = []
    script = """
    def f():
      thread before():
        sleep(1)
      end
      thread calls():
        stop_now()
        log("up to the next wait")
        sync()
        log("never")
      end
      thread after():
        log("never")
      end
      run before()
      run calls()
      run after()
      sleep(1)
    end
    """
    runtime: ProgramRuntime
    runtime = start(script, log, Builtin("stop_now", lambda: runtime.stop()))
    runtime.on_thread_end = ended.append
    runtime.step()
    assert log == ["up to the next wait"]
    assert runtime.finished
    assert sorted(ended) == [1, 2, 3, 4]


def test_the_end_of_a_thread_may_stop_the_program() -> None:
    ended: list[int] = []
    script = "def f():\n thread t():\n end\n run t()\n run t()\n sleep(1)\nend"
    runtime = start(script, [])

    def stop(handle: int) -> None:
        ended.append(handle)
        runtime.stop()

    runtime.on_thread_end = stop
    runtime.step()
    assert runtime.finished
    assert sorted(ended) == [1, 2, 3]


def test_an_error_stops_every_thread() -> None:
    ended: list[int] = []
    script = "def f():\n thread t():\n  x = 1 / 0\n end\n run t()\n sleep(1)\nend"
    runtime = start(script, [])
    runtime.on_thread_end = ended.append
    with pytest.raises(ScriptRuntimeError) as caught:
        runtime.step()
    assert (caught.value.line, caught.value.column) == (3, 3)
    assert runtime.finished
    assert sorted(ended) == [1, 2]
    runtime.step()


def test_programs_are_cached_and_share_nothing_between_controllers() -> None:
    text = "def f():\n say()\nend"
    heard: list[str] = []
    one = compile_program(text, {"say": Builtin("say", lambda: heard.append("one"))})
    two = compile_program(text, {"say": Builtin("say", lambda: heard.append("two"))})
    assert one.code is two.code
    for program in (two, one):
        runtime = ProgramRuntime(program, TICK)
        runtime.start()
        runtime.step()
    assert heard == ["two", "one"]

    def wait() -> Generator[None]:
        yield

    blocking = compile_program(text, {"say": Builtin("say", wait, blocking=True)})
    assert blocking.code is not one.code
