"""Failures inside the contract explain themselves."""

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")
