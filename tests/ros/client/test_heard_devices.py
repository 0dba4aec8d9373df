"""What is kept of the drivers of devices that are heard."""

import json
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from crtk_drivers.client.heard_devices import HeardDevice
from crtk_drivers.ros.presence import GONE_AFTER

pytestmark = pytest.mark.ros


def said(number, arrived):
    word = {"id": str(number), "driver": "ur", "host": "control", "pid": 1}
    text = json.dumps({**word, "started": number, "established": True, "there": True})
    return SimpleNamespace(text=text, arrived=arrived)


def test_drivers_that_are_gone_are_forgotten():
    device = HeardDevice("arm", "/arm", lambda: None)
    now = time.monotonic()
    for number in range(1000):
        device.hear_word(said(number, now - 2.0 * GONE_AFTER))
    device.hear_word(said(1000, now))
    assert [word.key for word in device.drivers()] == ["1000"]
    assert len(device._words) == 1
