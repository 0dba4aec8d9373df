"""Programs whose system clock is off, as on another machine: all of it, DDS and rclpy included.

`time.time_ns` alone, as faults of the table replace it, is the clock of our code only: what DDS stamps stays.
Here a library that is loaded first answers `clock_gettime` and its like, and takes back the shift from the
times until which a program waits by that clock. The monotonic clock is left alone.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rigs.waiting import LONG

LIBRARY = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>

static long long shift_ns(void) {
    static long long ns, known;
    if (!known) {
        const char *told = getenv("CLOCK_SHIFT_NS");
        ns = told ? atoll(told) : 0;
        known = 1;
    }
    return ns;
}

static struct timespec moved(struct timespec at, long long ns) {
    at.tv_sec += ns / 1000000000LL;
    at.tv_nsec += ns % 1000000000LL;
    if (at.tv_nsec >= 1000000000L) { at.tv_nsec -= 1000000000L; at.tv_sec += 1; }
    if (at.tv_nsec < 0) { at.tv_nsec += 1000000000L; at.tv_sec -= 1; }
    return at;
}

int clock_gettime(clockid_t clock, struct timespec *at) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(clock, at);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        *at = moved(*at, shift_ns());
    return failed;
}

int gettimeofday(struct timeval *restrict at, void *restrict zone) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    at->tv_sec = now.tv_sec;
    at->tv_usec = now.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *at) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (at) *at = now.tv_sec;
    return now.tv_sec;
}

/* A time since the epoch, not since the machine was started: it was made by this clock. */
static struct timespec back(const struct timespec *until) {
    return until->tv_sec > 1000000000L ? moved(*until, -shift_ns()) : *until;
}

int pthread_cond_timedwait(pthread_cond_t *restrict c, pthread_mutex_t *restrict m,
                           const struct timespec *restrict until) {
    static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!real) real = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    if (!real) real = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
    struct timespec at = back(until);
    return real(c, m, &at);
}

int sem_timedwait(sem_t *restrict s, const struct timespec *restrict until) {
    static int (*real)(sem_t *, const struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "sem_timedwait");
    struct timespec at = back(until);
    return real(s, &at);
}

int pthread_mutex_timedlock(pthread_mutex_t *restrict m, const struct timespec *restrict until) {
    static int (*real)(pthread_mutex_t *, const struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
    struct timespec at = back(until);
    return real(m, &at);
}
"""

YEAR = 365.0 * 86400.0
OFFSETS = (0.006, -0.006, 2.0, -2.0, YEAR, -YEAR)
"""Seconds by which the clock of the other machine is ahead."""


@cache
def _library() -> tuple[Path, TemporaryDirectory[str]]:
    """Compile what shifts the clock; return where it is, and its folder, which ends with this process."""
    folder = TemporaryDirectory(prefix="shifted_clock")
    path = Path(folder.name) / "shifted_clock.so"
    compiler = shutil.which("cc")
    assert compiler, "a C compiler is needed, as for building crtk_msgs"
    command = [compiler, "-shared", "-fPIC", "-x", "c", "-o", str(path), "-", "-ldl"]
    subprocess.run(command, input=LIBRARY, text=True, check=True)
    return path, folder


def shifted(seconds: float, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return the environment of programs whose clock is ahead by so much, and of all that they start."""
    path = os.pathsep.join(filter(None, sys.path))
    shift = (
        {}
        if not seconds
        else {
            "LD_PRELOAD": str(_library()[0]),
            "CLOCK_SHIFT_NS": str(round(1e9 * seconds)),
        }
    )
    return {**environment, "PYTHONPATH": path, **shift}


def told_by(seconds: float, program: str, *arguments: str) -> Any:
    """Run a program whose clock is off, and return what it prints last, which is JSON."""
    ended = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env=shifted(seconds),
        capture_output=True,
        text=True,
        timeout=3.0 * LONG,
    )
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout.splitlines()[-1])
