"""Fixtures for all tests; see support.py for the helpers."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from support import SHARED

# No deadline: a shared machine may stop for a second, and that is no failure. In CI the examples
# are the same in every run; elsewhere new ones are tried each time.
settings.register_profile(
    "dronepose",
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "dronepose-ci", settings.get_profile("dronepose"), derandomize=True, print_blob=True
)
CI = os.environ.get("CI", "").lower() not in ("", "0", "false")
settings.load_profile("dronepose-ci" if CI else "dronepose")


@pytest.fixture
def shared() -> Callable[[str], Path]:
    """A path in the folder of test data, or a skip that says which is missing."""

    def find(relative: str) -> Path:
        path = SHARED / relative
        if not path.exists():
            pytest.skip(f"{relative} is not in ../shared (or DRONEPOSE_SHARED)")
        return path

    return find
