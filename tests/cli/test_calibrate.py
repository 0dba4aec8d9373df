"""``crtk-driver calibrate`` from files: what is printed goes into configurations as it stands."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from crtk_drivers.cli import main
from crtk_drivers.config.settings import BaseConfig, KinematicsConfig, PoseConfig
from crtk_drivers.geometry.conversions import to_matrix
from crtk_drivers.labs.calibration.measured_files import POINT, POSE, rows_of, write_table
from crtk_drivers.labs.calibration.stillness import distance
from rigs.measured_poses import about_its_tip, arm_and_marker, pose

TIP = (0.018, -0.003, -0.157)
MARKER, TRACKER = (
    pose((0.02, -0.05, 0.11), (0.5, 1.2, -0.7)),
    pose((1.4, 0.3, 0.8), (-1.0, 2.0, 0.4)),
)


def tables(printed: str) -> dict[str, object]:
    return tomllib.loads(printed[printed.index("# ") :])


def test_a_pivot_from_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = about_its_tip(TIP, (0.1, -0.2, -1.3), 200, 0.5, np.random.default_rng(1), 0.25e-3)
    write_table(tmp_path / "pivot.csv", {"": rows_of(poses)}, POSE)
    assert main(["calibrate", "pivot", "--file", str(tmp_path / "pivot.csv")]) == 0
    printed = capsys.readouterr().out
    assert "200, turned by up to" in printed
    tip = PoseConfig.model_validate(tables(printed)["tip"])
    assert np.allclose(tip.position, TIP, atol=0.2e-3)


def test_a_registration_from_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = np.array([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)], dtype=float)
    matrix = to_matrix(TRACKER)
    measured = model @ matrix[:3, :3].T + matrix[:3, 3]
    path = tmp_path / "pairs.csv"
    write_table(path, {"model": model, "measured": measured}, POINT)
    assert main(["calibrate", "register", "--file", str(path), "--target", "0.1,0.1,0.1"]) == 0
    printed = capsys.readouterr().out
    assert "TRE at 100.00 100.00 100.00" in printed
    found = PoseConfig.model_validate(tables(printed)["pose"])
    assert max(distance(found.pose, TRACKER)) < 1e-5


@pytest.mark.parametrize("method", ["park", "tsai"])
def test_hand_eye_from_a_file(
    method: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm, seen = arm_and_marker(MARKER, TRACKER, 12, np.random.default_rng(2))
    path = tmp_path / "pairs.csv"
    write_table(path, {"arm": rows_of(arm), "marker": rows_of(seen)}, POSE)
    assert main(["calibrate", "hand-eye", "--file", str(path), "--method", method]) == 0
    found = tables(capsys.readouterr().out)
    base = BaseConfig.model_validate(found["base"])
    assert max(distance(base.pose, TRACKER)) < 1e-5
    kinematics = KinematicsConfig.model_validate({"urdf": "a.urdf", **found["kinematics"]})  # type: ignore[dict-item]
    assert kinematics.tool is not None
    assert max(distance(kinematics.tool.pose, MARKER)) < 1e-5


@pytest.mark.parametrize(
    ("arguments", "told", "code"),
    [
        (["pivot"], "which device?", 2),
        (["register"], "which points?", 2),
        (["register", "--file", "none.csv"], "cannot be read", 2),
        (["register", "--target", "1,2"], "is no place", 2),
        (["hand-eye", "--method", "magic"], "is no method", 2),
    ],
)
def test_what_cannot_be_used_is_refused_in_words(
    arguments: list[str], told: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", *arguments]) == code
    assert told in capsys.readouterr().err


def test_measurements_that_tell_nothing_end_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_table(tmp_path / "still.csv", {"": rows_of([MARKER] * 40)}, POSE)
    assert main(["calibrate", "pivot", "--file", str(tmp_path / "still.csv")]) == 1
    assert "hardly turned" in capsys.readouterr().err
