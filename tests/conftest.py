"""What all tests share."""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# a busy machine is no defect of the code
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")

# started in the background of a shell: the programs under test would inherit it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

FIRST, BESIDE = "test_methods.py", "test_vpf_"
"""Files that one process begins with, which compiles what builds stores, and those for the other one meanwhile."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give files an order for two processes: nothing is compiled twice, and the longest come early."""
    count = Counter(item.path for item in items)

    def rank(item: pytest.Item) -> tuple[int, int, str]:
        name, n = item.path.name, count[item.path]
        if name == FIRST:
            return 0, 0, name
        return (1, n, name) if name.startswith(BESIDE) else (2, -n, str(item.path))

    items.sort(key=rank)


def slow_apart(values: Iterable[Any], slow: Collection[Any]) -> list[Any]:
    """Return values as parameters of tests, of which some stand in the slow stage."""
    return [pytest.param(value, marks=pytest.mark.slow if value in slow else ()) for value in values]


SHARED = Path(__file__).resolve().parents[2] / "shared"


def shared_dem(name: str) -> Path:
    """Return a DEM of the shared data beside the repository, or skip the test."""
    return _shared("dem", name)


def shared_feature(name: str) -> Path:
    """Return a file of lines or areas of the shared data beside the repository, or skip the test."""
    return _shared("features", name)


def shared_vpf(name: str) -> Path:
    """Return a file or directory of the real VPF data beside the repository, or skip the test."""
    return _shared("vpf", name)


def _shared(kind: str, name: str) -> Path:
    path = SHARED / "data" / kind / name
    if not path.exists():
        pytest.skip(f"../shared/data/{kind}/{name} is absent")
    return path
