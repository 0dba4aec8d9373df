"""Ordinary tests in virtual time: the mark lets pytest run them on a simulated machine."""

import time

import pytest

import crtk_drivers


@pytest.mark.world
def test_a_stage_holds_its_place() -> None:
    """It waits for half a minute of virtual time."""
    with crtk_drivers.connect("one_axis", sim=True, travel=0.8) as stage:
        stage.enable()
        assert stage.move_jp([0.5]).wait(10.0)
        time.sleep(30.0)
        assert stage.measured_js().position[0] == pytest.approx(0.5, abs=1e-3)
        assert stage.operating_state().state == "ENABLED"
