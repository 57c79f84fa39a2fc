"""Drawings: every style shows what it says, and what cannot be drawn is refused in one line."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.collections import PolyCollection
from surfaces import SOLID

from vpfx.cli import main
from vpfx.dem.reference import unit_metres
from vpfx.errors import InputError, StoreError
from vpfx.geometry import face_slopes
from vpfx.measures import face_errors, measure_accuracy
from vpfx.model import Extent, Tin
from vpfx.pipeline import build, build_hierarchy
from vpfx.plot import MOST_VECTORS, STYLES, draw_tin, find_pixels, picture, plot_tin

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures/dem"
CELL = FIXTURES / "new_mexico_cell_5min_1arcsec.tif"
TIN = build_hierarchy(SOLID["noise"], passes=2, grid=(3, 2)).tin(2)


def drawn(style, tin=TIN, **options):
    """Return the axes, the faces in them, and what a colour bar needs."""
    _, axis = pyplot.subplots()
    values = np.arange(tin.n_face) if style in ("error", "attribute") else None
    scale = draw_tin(axis, tin, style, values=values, **options)
    faces = next(part for part in axis.collections if isinstance(part, PolyCollection))
    pyplot.close("all")
    return axis, faces, scale


@pytest.mark.parametrize("style", STYLES)
def test_every_face_is_drawn(style):
    axis, faces, scale = drawn(style, title="noise")
    assert len(faces.get_paths()) == TIN.n_face
    assert (scale is not None) == (STYLES[style].quantity != "")
    assert axis.get_title() == "noise"
    texts = {text.get_text() for text in axis.texts}
    assert "N" in texts
    assert any(text.endswith(" m") for text in texts), "a scale bar"


def test_colours_tell_what_they_say():
    expected = {
        "slope": face_slopes(TIN.nodes, TIN.face_nodes)[0],
        "level": TIN.node_attributes["level"][TIN.face_nodes].max(axis=1),
        "attribute": np.arange(TIN.n_face),
    }
    for style, values in expected.items():
        _, faces, scale = drawn(style)
        assert (scale.norm.vmin, scale.norm.vmax) == (values.min(), values.max())
        np.testing.assert_allclose(faces.get_facecolor(), scale.to_rgba(values))


def test_a_view_is_painted_from_the_farthest_face():
    """Two faces one behind the other: the southern one comes last, and stands lower in the picture."""
    nodes = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0, 9, 0], [1, 9, 0], [0.5, 10, 0.0]])
    for faces in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]):
        _, painted, _ = drawn("wireframe", Tin(nodes, np.array(faces)))
        far, near = (path.vertices[:3].mean(axis=0) for path in painted.get_paths())
        assert near[1] < far[1]


def test_greatest_errors_of_faces():
    grid = SOLID["noise"]
    errors = face_errors(TIN, grid)
    assert errors.shape == (TIN.n_face,)
    assert errors.max() == pytest.approx(measure_accuracy(TIN, grid).max_error, rel=1e-12)


def test_large_meshes_are_pixels_in_the_frame():
    n = 110
    row, col = np.mgrid[:n, :n]
    nodes = np.stack([col.ravel(), row.ravel(), np.zeros(n * n)], axis=1)
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([first[:, None] + (0, 1, n + 1), first[:, None] + (0, n + 1, n)])
    assert len(faces) > MOST_VECTORS
    for count, is_raster in ((len(faces), True), (MOST_VECTORS, False)):
        assert drawn("plan", Tin(nodes, faces[:count]))[1].get_rasterized() == is_raster


@pytest.mark.parametrize("is_turned", [False, True])
def test_pixels_show_the_last_face_at_their_middle(is_turned):
    """Against barycentric shares of every face at every pixel; faces may be seen from below."""
    rng = np.random.default_rng(5)
    corners = rng.uniform(-5, 25, (40, 3, 2))
    corners = corners[:, ::-1].copy() if is_turned else corners
    found = find_pixels(corners, 20, 18)
    row, col = np.mgrid[0:20, 0:18].astype(float)
    expected = np.full((20, 18), -1)
    for face, (a, b, c) in enumerate(corners):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        shares = [
            ((q[0] - p[0]) * (row - p[1]) - (q[1] - p[1]) * (col - p[0])) / area for p, q in ((a, b), (b, c), (c, a))
        ]
        expected[np.min(shares, axis=0) >= 0] = face
    np.testing.assert_array_equal(found, expected)


def test_very_large_meshes_are_painted_as_pixels(monkeypatch):
    """The colours of an image are those of the faces under its pixels."""
    monkeypatch.setattr("vpfx.plot.MOST_POLYGONS", 2_000)
    tin = build_hierarchy(SOLID["noise"], method="quaternary", total=True, passes=5, grid=(3, 3)).tin(5)
    assert tin.n_face > 2_000
    for style in ("relief", "plan"):
        _, axis = pyplot.subplots()
        draw_tin(axis, tin, style)
        (image,) = axis.images
        assert not axis.collections
        colours = np.asarray(image.get_array())
        assert (colours[..., 3] == 255).all()
        assert (colours == colours[0, 0]).all() == (style == "plan")
        pyplot.close("all")


def test_pictures_are_whole_or_not_there(tmp_path):
    with pytest.raises(ZeroDivisionError), picture(tmp_path / "a.png"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
    for suffix in ("png", "pdf", "svg"):
        for name in ("a", "b"):
            plot_tin(TIN, tmp_path / f"{name}.{suffix}", "plan")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    assert len(list(tmp_path.iterdir())) == 6


def test_units_in_metres():
    assert unit_metres("", Extent(0, 0, 1, 1)) == (1.0, 1.0)
    assert unit_metres("EPSG:32613", Extent(0, 0, 1, 1)) == (1.0, 1.0)
    assert unit_metres("EPSG:2263", Extent(0, 0, 1, 1)) == pytest.approx((0.3048006, 0.3048006), rel=1e-6)  # feet
    width, height = unit_metres("EPSG:4269", Extent(-107.7, 36.3, -107.6, 36.4))
    assert (width / 3600, height / 3600) == pytest.approx((24.93, 30.82), abs=0.01)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    path = tmp_path_factory.mktemp("plot") / "nm.gpkg"
    build(CELL, path, max_error=(80, 40))
    return path


PICTURES = {
    "shaded.png": (),
    "wireframe.pdf": ("--style", "wireframe", "--level", "0"),
    "plan.svg": ("--style", "plan"),
    "error.png": ("--style", "error", "--dem", str(CELL)),
    "aspect.png": ("--style", "attribute", "--attribute", "aspect"),
}
BEGINNINGS = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_of_a_store(name, store, tmp_path):
    picture = tmp_path / name
    with pytest.raises(SystemExit) as exit_:
        main(["plot", str(store), "-o", str(picture), *PICTURES[name]])
    assert exit_.value.code == 0
    assert picture.read_bytes().startswith(BEGINNINGS[picture.suffix])
    if picture.suffix == ".png":
        pixels = pyplot.imread(picture)
        assert min(pixels.shape[:2]) >= 1000
        assert pixels[..., :3].std() > 0.05, "not blank"


REFUSED = {
    "unknown style": (("--style", "oil"), 2, "found style 'oil', expected one of: plan"),
    "error without DEM": (("--style", "error"), 2, "found no DEM"),
    "unknown attribute": (("--style", "attribute", "--attribute", "soil"), 2, "found attribute 'soil', expected one"),
    "no such level": (("--level", "7"), 3, "found no level 7"),
    "nothing there": (("--bbox", "0,0,1,1"), 2, "found no face"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_drawn_is_refused(name, store, tmp_path, capsys):
    options, code, message = REFUSED[name]
    with pytest.raises(SystemExit) as exit_:
        main(["plot", str(store), "-o", str(tmp_path / "a.png"), *options])
    assert exit_.value.code == code
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "a.png").exists()


def test_pictures_are_not_replaced_unasked(tmp_path):
    (tmp_path / "a.png").write_text("mine")
    with pytest.raises(StoreError, match="existing file"):
        plot_tin(TIN, tmp_path / "a.png")
    with pytest.raises(InputError, match=r"found suffix '\.gif', expected \.png"):
        plot_tin(TIN, tmp_path / "a.gif")
    plot_tin(TIN, tmp_path / "a.png", overwrite=True)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
