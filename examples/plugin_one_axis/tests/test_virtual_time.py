"""Ordinary tests in virtual time: pytest runs them on a simulated machine, since they are marked so."""

import time

import pytest

import crtk_drivers


@pytest.mark.world
def test_a_stage_holds_its_place() -> None:
    """The half minute is one of the simulated machine."""
    with crtk_drivers.connect("one_axis", sim=True, travel=0.8) as stage:
        stage.enable()
        assert stage.move_jp([0.5]).wait(10.0)
        time.sleep(30.0)
        assert stage.measured_js().position[0] == pytest.approx(0.5, abs=1e-3)
        assert stage.operating_state().state == "ENABLED"
