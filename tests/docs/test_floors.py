"""The house as its decision says: few rooms, few floors, one name for one thing."""

import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
CORE = ROOT / "crtk_drivers"


def test_the_core_has_few_rooms_on_ten_floors():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
        "contracts"
    ]
    (floors,) = (each["layers"] for each in contracts if each["type"] == "layers")
    rooms = [room.strip(" |:") for floor in floors for room in floor.split() if room.strip("|:")]
    assert len(floors) <= 10
    assert len(rooms) <= 26
    page = (ROOT / "docs" / "architecture.md").read_text()
    plan = page.split("## The core, floor by floor")[1].split("**The words.**")[0]
    drawn = [line.split() for line in plan.splitlines() if line.startswith("    ")]
    assert [sorted(line) for line in drawn] == [
        sorted(floor.replace("|", "").replace(":", "").split()) for floor in floors
    ]


def test_no_two_modules_of_the_core_share_a_name():
    stems = Counter(
        path.stem
        for path in CORE.rglob("*.py")
        if "templates" not in path.parts and not path.stem.startswith("__")
    )
    assert [stem for stem, times in stems.items() if times > 1] == []
