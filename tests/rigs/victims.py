"""Drivers in processes of their own, which tests kill or freeze: forked from one that has imported them.

A Python that starts and imports a driver takes a second of CPU, and on a busy machine half a minute.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict

from bench.reliability.activities import Plan
from crtk_drivers.config import DeviceConfig
from rigs.warm_start import Process, server


def start(options: str, activity: str) -> Process:
    """Do what `bench.reliability.procedures` does, and sooner."""
    arguments = [options, activity]
    return server().start_program("bench.reliability.victim", arguments, None, None, ())


@contextmanager
def victim(plugin: str, config: DeviceConfig, plan: Plan, activity: str) -> Iterator[Process]:
    """A driver that enables its device and does something, until it is killed at the end."""
    values = json.loads(config.model_dump_json(exclude_unset=True))
    options = {"plugin": plugin, "config": values, "plan": asdict(plan)}
    with start(json.dumps(options), activity) as process:
        try:
            yield process
        finally:
            process.kill()
