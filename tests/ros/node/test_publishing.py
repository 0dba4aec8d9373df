"""The publishing thread: rates, order on demand, failures, and an end although a writer blocks."""

from __future__ import annotations

import logging
import threading

import pytest

from crtk_drivers.ros.publishing import PublishingThread
from rigs.waiting import LONG, eventually


def test_runs_on_demand_and_at_a_rate() -> None:
    thread = PublishingThread("test")
    runs = {"fast": 0, "slow": 0, "asked": 0}

    def count(name: str) -> None:
        runs[name] += 1

    thread.job("fast", lambda: count("fast"), 200.0)
    slow = thread.job("slow", lambda: count("slow"), 0.001)
    asked = thread.job("asked", lambda: count("asked"))
    thread.start()
    eventually(lambda: runs["fast"] >= 10, "ten runs")
    assert runs["asked"] == runs["slow"] == 0
    asked.ask()
    eventually(lambda: runs["asked"] == 1, "the job that was asked for")
    slow.set_rate(500.0)
    eventually(lambda: runs["slow"] > 3, "the rate that was changed")
    assert thread.stop(LONG)
    assert runs["asked"] == 1


def test_what_was_asked_for_is_done_before_the_end() -> None:
    thread = PublishingThread("test")
    done: list[str] = []
    job = thread.job("last words", lambda: done.append("x"))
    thread.start()
    job.ask()
    assert thread.stop(LONG)
    assert done


def test_a_failing_job_is_logged_seldom_and_stops_no_other(
    caplog: pytest.LogCaptureFixture,
) -> None:
    thread = PublishingThread("test")
    runs = {"bad": 0, "good": 0}

    def bad() -> None:
        runs["bad"] += 1
        raise RuntimeError("no luck")

    def good() -> None:
        runs["good"] += 1

    thread.job("bad", bad, 500.0)
    thread.job("good", good, 500.0)
    with caplog.at_level(logging.ERROR):
        thread.start()
        eventually(lambda: min(runs.values()) > 20, "twenty runs of both")
        assert thread.stop(LONG)
    failures = [r for r in caplog.records if "publishing bad failed" in r.getMessage()]
    assert 1 <= len(failures) < 10
    assert failures[0].exc_info


def test_stop_gives_up_on_a_writer_that_blocks() -> None:
    thread = PublishingThread("test")
    blocked, release = threading.Event(), threading.Event()

    def block() -> None:
        blocked.set()
        release.wait()

    thread.job("blocked", block).ask()
    thread.start()
    assert blocked.wait(LONG)
    assert not thread.stop(0.05)
    release.set()
    assert thread.stop(LONG)


def test_missed_runs_are_skipped() -> None:
    thread = PublishingThread("test")
    job = thread.job("job", lambda: None, 10.0)
    start = job.due
    job.advance(start + 1.234)
    assert job.due == pytest.approx(start + 1.3)
    job.advance(start + 1.25)
    assert job.due == pytest.approx(start + 1.3)
