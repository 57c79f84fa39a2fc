"""Drawings of one level with matplotlib: from above or as a view from the south-west, with scale bar, north and colour bar.

Small meshes are drawn as lines and areas, large ones as pixels inside the same frame; edges that would be finer than the
pixels are left out, so that a million faces take seconds (specs/methods.md M-700).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.dem import read_grid
from vpfx.errors import InputError, NotFoundError, StoreError
from vpfx.geometry import face_slopes
from vpfx.measures import face_errors
from vpfx.methods.scan import columns_of, place_sides, rows_of
from vpfx.model import Tin

__all__ = ["STYLES", "Style", "check_picture", "draw_tin", "find_pixels", "find_values", "picture", "plot_tin"]

Floats = NDArray[np.float64]

SUN_AZIMUTH, SUN_HEIGHT = 315.0, 45.0  # degrees
VIEW_AZIMUTH, VIEW_HEIGHT = 20.0, 35.0  # degrees: looking to the north-north-east, so far down
RELIEF_SHARE = 0.12  # of the extent: how high the relief is drawn in a view, if its own is less
MOST_VECTORS = 20_000  # faces drawn as vectors in PDF and SVG
MOST_POLYGONS = 200_000  # faces that matplotlib paints; more are painted here, pixel by pixel
FINER = 2  # so many of those pixels to one of the picture, across and up
LEAST_EDGE = 4.0  # pixels of a mean face with edges
EDGE_PIXELS, EDGE_DARKNESS = 0.7, 0.5  # width of an edge, and how much of the light it takes
DPI = 200
FOOT = 0.5  # inches: height of the strip below with scale bar and north
INCHES = 7.0
UNDATED = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}  # so that the same mesh gives the same bytes


class Style(NamedTuple):
    """How a level is drawn.

    Attributes
    ----------
    is_view : bool
        Whether as a view from above the ground, else from straight above.
    has_edges : bool
    quantity : str
        What colours tell, with its unit; empty for none.
    is_shaded : bool
        Whether by the sun as well.
    """

    is_view: bool
    has_edges: bool
    quantity: str
    is_shaded: bool


STYLES = {
    "plan": Style(False, True, "", False),
    "wireframe": Style(True, True, "", False),
    "shaded": Style(True, True, "height, m", True),
    "relief": Style(False, False, "height, m", True),
    "slope": Style(False, True, "slope, degrees", False),
    "level": Style(False, True, "level of the newest corner", False),
    "error": Style(False, True, "greatest error, m", False),
    "attribute": Style(False, True, "attribute", False),
}


def _pyplot() -> Any:
    """Return matplotlib's pyplot, or say how to install it."""
    try:
        import matplotlib
    except ImportError:
        raise NotFoundError("plot: found no matplotlib, expected it: pip install 'vpfx[plot]'") from None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def draw_tin(
    axis: Any, tin: Tin, style: str, *, metres: tuple[float, float] = (1.0, 1.0), values: Floats | None = None,
    title: str = "",
) -> Any:  # fmt: skip
    """Draw a level into axes of matplotlib.

    Parameters
    ----------
    axis : matplotlib.axes.Axes
    tin : Tin
    style : str
        Name in `STYLES`.
    metres : tuple of float
        Size of a unit of x and of y, metres.
    values : float64 (n_face,), optional
        What the colours of the styles error and attribute tell.

    Returns
    -------
    matplotlib.cm.ScalarMappable or None
        For a colour bar.

    Raises
    ------
    InputError
        There is no such style, no face, or values are missing.
    """
    if style not in STYLES:
        raise InputError(f"plot: found style {style!r}, expected one of: {', '.join(STYLES)}")
    if tin.n_face == 0:
        raise InputError("plot: found no face, expected some")
    look = STYLES[style]
    nodes = tin.nodes * np.array([*metres, 1.0])
    nodes = nodes - np.append(nodes[:, :2].min(axis=0), nodes[:, 2].mean())
    quantity = _quantity(tin, nodes, style, values)
    place, order = _project(nodes, tin.face_nodes) if look.is_view else (nodes[:, :2], np.arange(tin.n_face))
    colours, scale = _colours(nodes, tin.face_nodes, look, quantity)
    _paint(axis, place[tin.face_nodes[order]], colours[order], look)
    _decorate(axis, place, look, title)
    return scale


def _quantity(tin: Tin, nodes: Floats, style: str, values: Floats | None) -> Floats | None:
    """What the colours of a style tell of each face."""
    found: dict[str, Callable[[], Any]] = {
        "shaded": lambda: tin.nodes[:, 2][tin.face_nodes].mean(axis=1),
        "slope": lambda: face_slopes(nodes, tin.face_nodes)[0],
        "level": lambda: tin.node_attributes["level"][tin.face_nodes].max(axis=1).astype(np.float64),
    }
    found["relief"] = found["shaded"]
    if style in ("error", "attribute"):
        if values is None or len(values) != tin.n_face:
            raise InputError(f"plot: found no value for each face, which style {style} needs")
        numbers = np.asarray(values, np.float64)
        if np.isnan(numbers).all():
            raise InputError("plot: found no number among the values of the faces, expected some")
        return numbers
    return np.asarray(found[style](), np.float64) if style in found else None


def _project(nodes: Floats, face_nodes: NDArray[np.int32]) -> tuple[Floats, NDArray[np.int64]]:
    """Places of the nodes in a parallel view, metres, and the faces from the farthest to the nearest."""
    size, relief = np.ptp(nodes[:, :2], axis=0).max(), max(float(np.ptp(nodes[:, 2])), 1e-9)
    raised = max(1.0, RELIEF_SHARE * size / relief)
    azimuth, height = np.radians(VIEW_AZIMUTH), np.radians(VIEW_HEIGHT)
    across = nodes[:, 0] * np.cos(azimuth) - nodes[:, 1] * np.sin(azimuth)
    away = nodes[:, 0] * np.sin(azimuth) + nodes[:, 1] * np.cos(azimuth)
    up = away * np.sin(height) + raised * nodes[:, 2] * np.cos(height)
    order = np.argsort(-away[face_nodes].mean(axis=1), kind="stable")
    return np.stack([across, up], axis=1), order


def _colours(nodes: Floats, face_nodes: NDArray[np.int32], look: Style, quantity: Floats | None) -> tuple[Floats, Any]:
    """Colour of each face, and what a colour bar needs."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    scale, colours = None, np.ones((len(face_nodes), 4))
    if quantity is not None:
        low, high = float(np.nanmin(quantity)), float(np.nanmax(quantity))
        earth = look.quantity.startswith("height")
        scale = ScalarMappable(
            Normalize(low, high if high > low else low + 1.0), colormaps["gist_earth" if earth else "viridis"]
        )
        colours = scale.to_rgba(quantity)
    if look.is_shaded:
        slope, aspect = (np.radians(np.nan_to_num(part)) for part in face_slopes(nodes, face_nodes))
        height, azimuth = np.radians(SUN_HEIGHT), np.radians(SUN_AZIMUTH)
        light = np.sin(height) * np.cos(slope) + np.cos(height) * np.sin(slope) * np.cos(azimuth - aspect)
        colours[:, :3] *= (0.25 + 0.75 * np.clip(light, 0.0, 1.0))[:, None]
    return colours, scale


def _paint(axis: Any, corners: Floats, colours: Floats, look: Style) -> None:
    """Put the faces into the axes: as polygons, or as pixels if there are many."""
    from matplotlib.collections import PolyCollection

    low, high = corners.reshape(-1, 2).min(axis=0), corners.reshape(-1, 2).max(axis=0)
    inch = _inch(axis, high - low)
    pixels = DPI / inch
    has_edges = look.has_edges and float((high - low).prod()) * pixels**2 / len(corners) > LEAST_EDGE
    if look.has_edges and not has_edges and not look.quantity:
        colours[:, :3] *= 1.0 - _edge_shares(corners * pixels)[:, None]
    if len(corners) > MOST_POLYGONS:
        size = np.maximum(np.ceil((high - low) * pixels * FINER), 1).astype(np.int64)
        face = find_pixels((corners - low) / (high - low) * size - 0.5, *size[::-1])
        image = np.zeros((*face.shape, 4), np.uint8)
        image[face >= 0] = (255 * colours).astype(np.uint8)[face[face >= 0]]
        axis.imshow(image, extent=(low[0], high[0], low[1], high[1]), origin="lower", interpolation="antialiased")
    else:
        faces = PolyCollection(
            corners,  # type: ignore[arg-type]
            facecolors=colours, edgecolors="#00000080" if has_edges else "face",
            linewidths=0.25 if has_edges else 0.1, rasterized=len(corners) > MOST_VECTORS, antialiaseds=has_edges,
        )  # fmt: skip
        axis.add_collection(faces)
    margin = 0.02 * (high - low)
    axis.set_xlim(low[0] - margin[0], high[0] + margin[0])
    axis.set_ylim(low[1] - FOOT * inch, high[1] + margin[1])
    axis.set_aspect("equal")
    axis.set_axis_off()


def _inch(axis: Any, size: Floats) -> float:
    """Metres to an inch of axes that show a width and a height."""
    window = axis.get_window_extent()
    return max(float(np.max(size * axis.figure.dpi / (window.width, window.height))), 1e-9)


def _edge_shares(corners: Floats) -> Floats:
    """How much of each face its edges would darken, were they drawn; corners in pixels."""
    sides = np.roll(corners, -1, axis=1) - corners
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
    perimeter = np.hypot(sides[..., 0], sides[..., 1]).sum(axis=1)
    return EDGE_DARKNESS * np.minimum(perimeter * EDGE_PIXELS / 2 / np.maximum(area, 1e-9), 1.0)


@njit(nogil=True, cache=True)
def find_pixels(corners, n_row, n_col):  # type: ignore[no-untyped-def]
    """Find the last face at the middle of each pixel.

    Parameters
    ----------
    corners : float64 (n_face, 3, 2)
        Columns and rows; the middles of pixels are whole numbers.
    n_row, n_col : int

    Returns
    -------
    int64 (n_row, n_col)
        -1 where there is none.

    Notes
    -----
    Cost: O(faces + pixels of the faces).
    """
    found = np.full((n_row, n_col), -1, np.int64)
    corner, steps = np.empty((3, 3)), np.empty((3, 7))
    for face in range(len(corners)):
        a, b, c = corners[face]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        for i in range(3):
            at = i if area > 0.0 else 2 - i
            corner[i, 0], corner[i, 1] = corners[face, at, 0], corners[face, at, 1]
        place_sides(corner, steps)
        south, north = rows_of(corner, n_row)
        for row in range(south, north + 1):
            first, last = columns_of(corner, steps, row, n_col)
            for col in range(first, last + 1):
                found[row, col] = face
    return found


def _decorate(axis: Any, place: Floats, look: Style, title: str) -> None:
    """Add a scale bar, north and a title."""
    (x0, y0), (x1, y1) = place.min(axis=0), place.max(axis=0)
    inch, width = _inch(axis, np.array([x1 - x0, y1 - y0])), x1 - x0
    length = 10.0 ** np.floor(np.log10(width / 4))
    length *= max(step for step in (1, 2, 5) if step * length <= width / 4)
    y = y0 - FOOT / 2 * inch
    axis.plot([x0, x0 + length], [y, y], color="black", linewidth=2, solid_capstyle="butt")
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    axis.text(x0 + length + 0.05 * inch, y, text, va="center", fontsize=8)
    turn, flat = (np.radians(-VIEW_AZIMUTH), np.sin(np.radians(VIEW_HEIGHT))) if look.is_view else (0.0, 1.0)
    foot = np.array([x1 - 0.2 * inch, y0 - 0.9 * FOOT * inch])
    tip = foot + np.array([np.sin(turn), np.cos(turn) * flat]) * 0.7 * FOOT * inch
    axis.annotate("N", foot, tip, ha="center", va="center", fontsize=8, arrowprops={"arrowstyle": "<-"})
    axis.set_title(title, fontsize=9)


def find_values(tin: Tin, style: str, dem: Sequence[str], attribute: str | None) -> Floats | None:
    """What the styles error and attribute draw: errors at the posts of a DEM, or an attribute of the faces.

    Raises
    ------
    InputError
        There is no DEM for errors, or no such attribute.
    """
    if style == "error":
        if not dem:
            raise InputError("plot: found no DEM, expected one for style error; give --dem")
        return face_errors(tin, read_grid(list(dem)))
    if style == "attribute":
        if attribute not in tin.face_attributes:
            known = ", ".join(sorted(tin.face_attributes))
            raise InputError(f"plot: found attribute {attribute!r}, expected one of: {known}")
        return np.asarray(tin.face_attributes[attribute], np.float64)
    return None


def plot_tin(
    tin: Tin, path: str | Path, style: str = "shaded", *, metres: tuple[float, float] = (1.0, 1.0),
    values: Floats | None = None, title: str = "", label: str = "", overwrite: bool = False,
) -> None:  # fmt: skip
    """Draw a level into a picture: PNG, PDF or SVG, by the suffix.

    Parameters
    ----------
    tin, style, metres, values, title
        As for `draw_tin`.
    label : str
        What the colour bar says instead of the quantity of the style.

    Raises
    ------
    InputError, NotFoundError, StoreError
        As for `draw_tin`; the suffix is another; matplotlib is missing; the file exists or cannot be written.
    """
    with picture(path, overwrite=overwrite) as (figure, ((axis,),)):
        scale = draw_tin(axis, tin, style, metres=metres, values=values, title=title)
        if scale is not None:
            figure.colorbar(scale, ax=axis, shrink=0.7, label=label or STYLES[style].quantity)


def check_picture(path: Path, overwrite: bool) -> None:
    """Refuse a picture that cannot be written.

    Raises
    ------
    InputError, StoreError
        The suffix is another; the file exists.
    """
    if path.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected .png, .pdf or .svg")
    if path.exists() and not overwrite:
        raise StoreError(f"{path}: found an existing file; give another name or --overwrite")
    if not path.absolute().parent.is_dir():
        raise StoreError(f"{path}: found no folder {path.parent}, expected one to write into")


@contextmanager
def picture(
    path: str | Path, rows: int = 1, columns: int = 1, *, size: tuple[float, float] = (INCHES, INCHES),
    overwrite: bool = False,
) -> Iterator[tuple[Any, Any]]:  # fmt: skip
    """Give an empty figure and its axes (rows, columns), and write it when all is drawn.

    Parameters
    ----------
    path : path
        Ending in .png, .pdf or .svg.
    rows, columns : int
    size : tuple of float
        Width and height of each of the axes, inches.
    overwrite : bool
        Whether an existing file is replaced, once the new one is complete.

    Raises
    ------
    InputError, NotFoundError, StoreError
        The suffix is another; matplotlib is missing; the file exists or cannot be written.
    """
    path = Path(path)
    check_picture(path, overwrite)
    pyplot = _pyplot()
    figure, axes = pyplot.subplots(
        rows, columns, figsize=(columns * size[0], rows * size[1]), layout="constrained", squeeze=False
    )
    under_way = path.with_name(f".{path.name}.{os.getpid()}.tmp{path.suffix}")
    try:
        yield figure, axes
        try:
            figure.savefig(under_way, dpi=DPI, bbox_inches="tight", metadata=UNDATED.get(path.suffix.lower()))
            under_way.replace(path)
        except OSError as error:
            raise StoreError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        under_way.unlink(missing_ok=True)
        pyplot.close(figure)
