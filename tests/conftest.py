"""What all tests share."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

# started in the background of a shell: the programs under test would inherit it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SHARED = Path(__file__).resolve().parents[2] / "shared"


def shared_dem(name: str) -> Path:
    """Return a DEM of the shared data beside the repository, or skip the test."""
    path = SHARED / "data" / "dem" / name
    if not path.is_file():
        pytest.skip(f"../shared/data/dem/{name} is absent")
    return path
