"""When something stood, and what was measured as a table."""

from pathlib import Path

import numpy as np
import pytest

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.calibration.measured_files import (
    POSE,
    poses_of,
    read_table,
    rows_of,
    write_table,
)
from crtk_drivers.labs.calibration.stacks import mean_pose
from crtk_drivers.labs.calibration.stillness import Still, StillPoses, distance
from crtk_drivers.samples import Pose, vector
from rigs.measured_poses import noisy, pose

HERE, THERE = pose((0.1, 0.0, 0.5), (0.1, 0.2, 0.3)), pose((0.2, 0.0, 0.5), (0.1, 0.2, 0.3))
STEP = 0.02


def taken(path: list[tuple[Pose, ...] | None]) -> list[tuple[int, tuple[Pose, ...]]]:
    """What is taken of poses that are read every `STEP` seconds: when, and the means."""
    still, found = StillPoses(Still()), []
    for at, poses in enumerate(path):
        if (means := still.feed(at * STEP, poses)) is not None:
            found.append((at, means))
    return found


def test_a_place_is_taken_once_after_it_has_stood_and_the_next_likewise() -> None:
    on_the_way = [(pose((x, 0.0, 0.5), (0.1, 0.2, 0.3)),) for x in np.linspace(0.1, 0.2, 20)]
    found = taken([(HERE,)] * 60 + on_the_way + [(THERE,)] * 60)
    assert [at for at, _ in found] == [25, 104]  # 0.5 s each, and not the step that moved
    assert distance(found[1][1][0], THERE)[0] < 1e-12


def test_what_moves_or_is_missing_is_not_taken_and_all_bodies_must_stand() -> None:
    moving = [pose((0.002 * n, 0.0, 0.0), (0.0, 0.0, 0.0)) for n in range(100)]
    turning = [pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.01 * n)) for n in range(100)]
    assert taken([(each,) for each in moving]) == []
    assert taken([(each,) for each in turning]) == []
    assert taken([(HERE, each) for each in moving]) == []
    assert taken([None if n % 20 == 0 else (HERE,) for n in range(200)]) == []


def test_a_mean_is_of_one_sign_of_the_quaternions() -> None:
    noise = np.random.default_rng(1)
    poses = [noisy(HERE, noise, 1e-4, 1e-3) for _ in range(50)]
    flipped = [
        Pose(each.position, vector(each.orientation * (-1) ** n)) for n, each in enumerate(poses)
    ]
    assert distance(mean_pose(flipped), HERE)[1] < 1e-3
    assert distance(mean_pose(flipped), mean_pose(poses)) == pytest.approx((0.0, 0.0), abs=1e-12)


def test_a_table_there_and_back(tmp_path: Path) -> None:
    path = tmp_path / "pairs.csv"
    write_table(path, {"arm": rows_of([HERE, THERE]), "marker": rows_of([THERE, HERE])}, POSE)
    found = read_table(path, ("arm", "marker"), POSE)
    assert np.array_equal(found["arm"], rows_of([HERE, THERE]))
    assert np.array_equal(rows_of(poses_of(found["marker"])), rows_of([THERE, HERE]))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "lacks the columns x, y, z"),
        ("x,y\n1,2\n", "lacks the columns z, qx"),
        ("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n1,2,three,0,0,0,1\n", "line 3"),
        ("x,y,z,qx,qy,qz,qw\n1,2,3\n", "line 2"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_by_line(
    tmp_path: Path, text: str, told: str
) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=told):
        read_table(path, ("",), POSE)


def test_other_columns_and_their_order_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("name,qw,qz,qy,qx,z,y,x\na,1,0,0,0,3,2,1\n\n")
    assert read_table(path, ("",), POSE)[""].tolist() == [[1, 2, 3, 0, 0, 0, 1]]
