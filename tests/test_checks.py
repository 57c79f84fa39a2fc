"""Numbers passed to `vpfx.build`: any integer type will do for a whole number, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from surfaces import hills, write_dem
from test_tiles import MODES

from vpfx.errors import InputError
from vpfx.pipeline import build

SENSELESS = {
    r"found -?\d+, expected (at least|0 … )": [
        *({"tile_size": size} for size in (7, -8, np.int8(-8))),
        *({"workers": number} for number in (0, -1, np.uint8(0))),
        *({"seed": seed} for seed in (-1, 1 << 31, np.int64(-1))),
    ],
    r"found .*, expected a whole number": [
        {name: value} for name in ("tile_size", "workers", "seed") for value in (8.5, 9.0, True, np.True_, "9", [9])
    ],
}


@pytest.mark.parametrize(("message", "options"), [(m, o) for m, cases in SENSELESS.items() for o in cases], ids=str)
def test_senseless_numbers_are_refused(message, options, tmp_path):
    dem = write_dem(tmp_path / "a.tif", hills(20, 20))
    with pytest.raises(InputError, match=message):
        build(dem, tmp_path / "a.gpkg", **MODES["bounded"], **options)
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


@pytest.mark.parametrize("mode", [*MODES, "budgets"])
def test_numbers_of_any_type_give_the_same_bytes(mode, tmp_path):
    """NumPy's numbers are as good as Python's, in the rows and in the metadata."""
    dem = write_dem(tmp_path / "a.tif", hills(20, 20))
    options = {"tile_size": 9, "workers": 1, "seed": 3, "fill": True, **MODES.get(mode, {"max_faces": (100, 300)})}
    build(dem, tmp_path / "one.gpkg", **options)
    kinds = {bool: np.bool_, int: np.int16, float: np.float32, str: str, tuple: np.array}
    build(dem, tmp_path / "other.gpkg", **{name: kinds[type(value)](value) for name, value in options.items()})
    assert (tmp_path / "one.gpkg").read_bytes() == (tmp_path / "other.gpkg").read_bytes()
