"""Draw the levels of a store side by side: shaded faces with their edges.

The picture of README.md was made so::

    vpfx build fixtures/dem/new_mexico_cell_5min_1arcsec.tif -o new_mexico.gpkg --max-error 40,20,10,5
    python bench/picture.py new_mexico.gpkg specs/levels.png
"""

from __future__ import annotations

import argparse

import vpfx
from vpfx.dem.reference import unit_metres
from vpfx.plot import draw_tin, picture

SIZE = 3.0, 2.4  # of one drawing, inches


def main() -> None:
    """Draw every level into one picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store")
    parser.add_argument("picture")
    parser.add_argument("--style", default="shaded", help="as of vpfx plot")
    given = parser.parse_args()
    with vpfx.open_store(given.store) as store:
        metres = unit_metres(store.crs, store.extent)
        with picture(given.picture, 1, len(store.levels), size=SIZE, overwrite=True) as (_, axes):
            for axis, line in zip(axes[0], store.levels, strict=True):
                bound = "" if line.max_error_bound is None else f", ±{line.max_error_bound:g} m"
                title = f"level {line.level}{bound}\n{line.faces:,} faces"
                draw_tin(axis, store.tin(line.level), given.style, metres=metres, title=title)


if __name__ == "__main__":
    main()
