"""The pictures of the docs: the architecture shows what there is, and no picture is missing or heavy."""

import xml.etree.ElementTree as ET
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_architecture_shows_every_device_and_has_no_empty_text():
    texts = ["".join(each.itertext()) for each in ET.parse(DOCS / "architecture.svg").iter()
             if each.tag.endswith("}text")]  # fmt: skip
    assert all(text.strip() for text in texts)
    for device in ("Universal Robots", "DYNAMIXEL", "CANopen", "ATI NetFT", "Virtual arm"):
        assert device in texts
    assert sum(text.startswith("Simulated ") for text in texts) == 4
