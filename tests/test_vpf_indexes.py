"""Spatial and thematic indexes of VPF: worked values, walks and scans that share no code with them, broken bytes, real data."""

from __future__ import annotations

import struct
from fractions import Fraction

import numpy as np
import pytest
from conftest import shared_vpf
from hypothesis import given, settings
from hypothesis import strategies as st

from vpfx.errors import InputError, VpfFormatError
from vpfx.vpf import spatial_index, thematic_index
from vpfx.vpf.table import read_table
from vpfx.vpf.values import Ragged

TEXASH = "vm2alv2_texash/texash"
TILE = "bnd/f/j/hb/1500"


# Spatial indexes ----------------------------------------------------------------------------------------------------


def decoded(data, order="<"):
    """Extent and bins of a spatial index, each a list of boxes and ids: V-300 once more, byte by byte."""
    n_primitive, *extent, n_bin = struct.unpack_from(f"{order}i4fi", data)
    bins = []
    for k in range(n_bin):
        offset, count = struct.unpack_from(f"{order}ii", data, 24 + 8 * k)
        at = 24 + 8 * n_bin + offset
        bins.append([struct.unpack_from(f"{order}4Bi", data, at + 8 * i) for i in range(count)])
    assert sum(map(len, bins)) == n_primitive
    return extent, bins


def place(number, first_axis=0, is_even_high=True):
    """Low and high corner of a bin in steps, by its number (V-302), or by another rule."""
    low, high = [0, 0], [255, 255]
    for cut, bit in enumerate(bin(number)[3:]):
        axis = (cut + first_axis) % 2
        at = low[axis] + ((high[axis] - low[axis]) >> 1)
        (low if (bit == "0") == is_even_high else high)[axis] = at
    return low, high


def touches(one, other):
    """Whether two boxes share a place."""
    return one[0] <= other[2] and other[0] <= one[2] and one[1] <= other[3] and other[1] <= one[3]


def walked(data, query):
    """Ids that a reader finds that walks the tree, as those known do: halves by their numbers, single precision."""
    extent, bins = decoded(data)
    scale = [np.float32(255 / (extent[axis + 2] - extent[axis])) for axis in (0, 1)]
    box = []
    for i, value in enumerate(query):
        axis = i % 2
        if value <= extent[axis]:
            box.append(0)
        elif value >= extent[axis + 2]:
            box.append(255)
        else:
            box.append(int((np.float32(value) - np.float32(extent[axis])) * scale[axis]) + (i > 1))
    found, waiting = set(), [1]
    while waiting:
        number = waiting.pop()
        low, high = place(number)
        if number <= len(bins) and touches([*low, *high], box):
            found |= {entry[4] for entry in bins[number - 1] if touches(entry, box)}
            waiting += [2 * number, 2 * number + 1]
    return found


coordinate = st.one_of(
    st.integers(-20, 20).map(float),
    st.floats(-20, 20, width=32),
    st.sampled_from([-20.0, 20.0, 0.1, -0.1]),
)
rectangle = st.tuples(coordinate, coordinate, coordinate, coordinate).map(
    lambda c: (min(c[0], c[2]), min(c[1], c[3]), max(c[0], c[2]), max(c[1], c[3]))
)


def test_worked_spatial_index():
    """Three edges in one bin: 24 + 8 + 3 × 8 bytes."""
    data = spatial_index.build([[0, 0, 5, 5], [5, 0, 10, 5], [0, 5, 10, 10]], (0, 0, 10, 10))
    assert data == bytes.fromhex(
        "03 00 00 00  00 00 00 00  00 00 00 00  00 00 20 41  00 00 20 41  01 00 00 00"
        "00 00 00 00  03 00 00 00"
        "00 00 80 80  01 00 00 00  7F 00 FF 80  02 00 00 00  00 7F FF FF  03 00 00 00"
    )


def test_worked_tree():
    """Sixteen points in a row go into two bins, the right half first; the one on the middle line stays above them."""
    places = np.linspace(0, 15, 16)[:, None] * [1, 0, 1, 0] + [0, 1, 0, 1]
    extent, bins = decoded(spatial_index.build(np.vstack([places, [[7, 0, 8, 2]]]), (0, 0, 15, 2)))
    assert extent == [0, 0, 15, 2]
    assert [[entry[4] for entry in entries] for entries in bins] == [
        [17], [], [], [9, 10, 11, 12, 13, 14, 15, 16], [], [1, 2, 3, 4, 5, 6, 7, 8], [],
    ]  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(
    boxes=st.lists(rectangle, max_size=120),
    queries=st.lists(rectangle, min_size=1, max_size=5),
)
def test_every_box_is_found(boxes, queries):
    data = spatial_index.build(np.array(boxes).reshape(-1, 4), (-20, -20, 20, 20))
    index = spatial_index.read(data)
    assert len(index.misplaced) == 0
    step = 40 / 255
    for query in [*queries, *boxes[:5]]:
        found = index.search(query).tolist()
        assert found == sorted(set(found))
        touching = {i for i, box in enumerate(boxes, 1) if touches(box, query)}
        near = [query[0] - 3 * step, query[1] - 3 * step, query[2] + 3 * step, query[3] + 3 * step]
        assert touching <= set(found) <= {i for i, box in enumerate(boxes, 1) if touches(box, near)}
        assert touching <= walked(data, query)


@settings(max_examples=60, deadline=None)
@given(
    boxes=st.lists(rectangle, min_size=1, max_size=40),
    margin=st.sampled_from([0, 1e-9, 0.3, 1e6]),
)
def test_boxes_hold_their_primitives(boxes, margin):
    """In exact arithmetic; and each lies in the smallest bin that holds it, as far down as the bins go."""
    boxes = np.array(boxes)
    extent = [*(boxes.min(axis=0)[:2] - margin), *(boxes.max(axis=0)[2:] + margin)]
    written, bins = decoded(spatial_index.build(boxes, extent))
    assert written[0] <= extent[0] <= extent[2] <= written[2]
    assert written[1] <= extent[1] <= extent[3] <= written[3]
    assert written[0] < written[2]
    assert written[1] < written[3]
    exact = [Fraction(value) for value in written]
    seen = []
    for number, entries in enumerate(bins, 1):
        low, high = place(number)
        for *steps, primitive in entries:
            box = boxes[primitive - 1]
            for axis in (0, 1):
                width = exact[axis + 2] - exact[axis]
                places = [(Fraction(box[i]) - exact[axis]) * 255 / width for i in (axis, axis + 2)]
                assert steps[axis] <= places[0] <= places[1] <= steps[axis + 2]
                assert places[0] - steps[axis] <= 1.001
                assert steps[axis + 2] - places[1] <= 1.001
                assert low[axis] <= steps[axis] <= steps[axis + 2] <= high[axis]
            for child in (2 * number, 2 * number + 1):
                if child <= len(bins):
                    low_child, high_child = place(child)
                    assert not all(low_child[i] <= steps[i] and steps[i + 2] <= high_child[i] for i in (0, 1))
            seen.append(primitive)
    assert sorted(seen) == list(range(1, len(boxes) + 1))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-3.4e38, 3.4e38), min_size=4, max_size=4))
def test_outward_holds_what_it_is_given(values):
    rounded = spatial_index.outward(values).astype(float)
    assert rounded.tolist() == spatial_index.outward(rounded).astype(float).tolist()
    assert all(rounded[:2] <= values[:2])
    assert all(rounded[2:] >= values[2:])
    nearest = np.array(values, np.float32)
    assert np.all(np.abs(rounded - values) <= 2 * np.abs(np.nextafter(nearest, np.float32(np.inf)) - nearest))


def test_bins_stay_small():
    rng = np.random.default_rng(7)
    corners = rng.random((100_000, 2)) * 99
    index = spatial_index.read(spatial_index.build(np.hstack([corners, corners + 0.01]), (0, 0, 100, 100)))
    sizes = np.diff(index.starts)
    assert index.n_bin == 32_767
    assert np.median(sizes[16_383:]) <= 2 * spatial_index.BIN_SIZE
    assert len(index.search((50, 50, 50.1, 50.1))) < 100


@pytest.mark.parametrize(("n", "n_bin"), [(0, 1), (1, 1), (7, 1), (8, 1), (9, 3), (12, 3), (23, 7), (40, 15)])
def test_number_of_bins(n, n_bin):
    """Where the real indexes have 7, 12, 23 and 40 primitives they have as many bins."""
    index = spatial_index.read(spatial_index.build(np.zeros((n, 4)), (0, 0, 1, 1)))
    assert (index.n_bin, len(index.ids)) == (n_bin, n)
    assert len(index.search((0, 0, 0, 0))) == n


@pytest.mark.parametrize("at", [0.0, 7.3, -97.75, 1e30, 1e-42])
def test_extent_without_width(at):
    data = spatial_index.build([[at, at, at, at]] * 3, (at, at, at, at))
    extent, _ = decoded(data)
    assert extent[0] < at < extent[2]
    assert walked(data, (at, at, at, at)) == {1, 2, 3}
    assert spatial_index.read(data).search((at, at, at, at)).tolist() == [1, 2, 3]


def test_extent_without_width_is_read():
    """Other producers may have written one."""
    data = struct.pack("<i4fi2i4Bi", 1, 3, 0, 3, 5, 1, 0, 1, 9, 9, 9, 9, 1)
    assert spatial_index.read(data).search((3, 0, 3, 5)).tolist() == [1]


@pytest.mark.parametrize(
    ("boxes", "extent"),
    [
        ([[0, 0, 2, 1]], (0, 0, 1, 1)),
        ([[-1, 0, 0, 1]], (0, 0, 1, 1)),
        ([[1, 0, 0, 1]], (0, 0, 1, 1)),
        ([[0, 0, np.nan, 1]], (0, 0, 1, 1)),
        ([[0, 0, 1, 1]], (1, 0, 0, 1)),
        ([[0, 0, 1, 1]], (0, 0, np.inf, 1)),
        ([[0, 0, 1, 1]], (0, 0, 1e39, 1)),
        ([[0, 0, 1, 1]], (0, 0, 1)),
    ],
)
def test_boxes_that_are_none(boxes, extent):
    with pytest.raises(InputError):
        spatial_index.build(boxes, extent)


@pytest.mark.parametrize("box", [(1, 0, 0, 1), (0, 0, 1), (0, 0, np.nan, 1)])
def test_questions_that_are_none(box):
    with pytest.raises(InputError, match="min x, min y, max x, max y"):
        spatial_index.read(spatial_index.build([[0, 0, 1, 1]], (0, 0, 1, 1))).search(box)


SMALL_SPATIAL = spatial_index.build(np.arange(24)[:, None] / 8 * [1, 1, 1, 1], (0, 0, 4, 4))


def judge_spatial(data):
    """A broken index is refused, or answers without harm."""
    try:
        index = spatial_index.read(data, "esi")
    except VpfFormatError:
        return
    assert len(index.search((-1e39, -1e39, 1e39, 1e39))) == len(index.ids)
    index.search((1, 1, 2, 2))
    assert len(index.misplaced) <= len(index.ids) <= len(data) // 8


def test_spatial_index_cut_at_every_byte():
    for n in range(len(SMALL_SPATIAL)):
        with pytest.raises(VpfFormatError):
            spatial_index.read(SMALL_SPATIAL[:n])
    assert spatial_index.read(SMALL_SPATIAL + b"\n").stray == 1


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_spatial_index_with_changed_bytes(data):
    changed = bytearray(SMALL_SPATIAL)
    for _ in range(data.draw(st.integers(1, 3))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    judge_spatial(bytes(changed))


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=80))
def test_spatial_index_of_any_bytes(data):
    judge_spatial(data)


@pytest.mark.parametrize(
    ("at", "number", "message"),
    [
        (0, 2**31 - 1, "header: found 2147483647 primitives and 7 bins"),
        (0, -1, "header: found -1 primitives"),
        (0, 23, "found 24 entries in bins, expected 23"),
        (20, 2**31 - 1, "header: found 24 primitives and 2147483647 bins"),
        (48, 4, "bin 4: found 8 entries at byte 4,"),
        (28, 2**31 - 1, "bin 1: found 2147483647 entries"),
        (28, -2, "bin 1: found -2 entries"),
        (48, 2**31 - 8, "bin 4: found 8 entries at byte 2147483640"),
        (48, -8, "bin 4: found 8 entries at byte -8"),
        (84, 0, "found the primitive 0, expected ids from 1 on"),
    ],
)
def test_numbers_in_a_spatial_index_are_bounded(at, number, message):
    changed = bytearray(SMALL_SPATIAL)
    struct.pack_into("<i", changed, at, number)
    with pytest.raises(VpfFormatError, match=message):
        spatial_index.read(bytes(changed))


def test_spatial_index_of_the_other_byte_order():
    n_bin = struct.unpack_from("<i", SMALL_SPATIAL, 20)[0]
    words = np.frombuffer(SMALL_SPATIAL, "<u4").byteswap()
    words[6 + 2 * n_bin :: 2] = np.frombuffer(SMALL_SPATIAL, "<u4")[6 + 2 * n_bin :: 2]  # boxes are bytes
    index, same = spatial_index.read(words.tobytes()), spatial_index.read(SMALL_SPATIAL)
    assert (index.order, same.order) == (">", "<")
    assert index.search((1, 1, 2, 2)).tolist() == same.search((1, 1, 2, 2)).tolist()


def test_half_order_does_not_matter_for_the_search():
    """A tree with the halves the other way round is searched as well; that others would miss its boxes is told."""
    extent, bins = decoded(SMALL_SPATIAL)
    bins[1], bins[2] = bins[2], bins[1]
    counts = [len(entries) for entries in bins]
    head = struct.pack("<i4fi", sum(counts), *extent, len(bins))
    table = b"".join(struct.pack("<2i", 8 * sum(counts[:k]), counts[k]) for k in range(len(bins)))
    body = b"".join(struct.pack("<4Bi", *entry) for entries in bins for entry in entries)
    index = spatial_index.read(head + table + body)
    assert sorted(index.misplaced) == sorted(entry[4] for entries in bins[1:3] for entry in entries)
    assert index.search((0, 0, 4, 4)).tolist() == list(range(1, 25))


def boxes_of(library, folder, name):
    """Boxes of the primitives that a real index is about, by rectangles or by their coordinates."""
    table = {"nsi": "end", "esi": "ebr", "fsi": "fbr", "tsi": "txt"}[name]
    rows = read_table(library / folder / table)
    if table in ("ebr", "fbr"):
        return np.stack([rows[column] for column in ("xmin", "ymin", "xmax", "ymax")], axis=1).astype(float)
    places = rows["coordinate" if table == "end" else "shape_line"]
    lists = (
        [places.values[a:b] for a, b in zip(places.starts, places.starts[1:], strict=False)]
        if isinstance(places, Ragged)
        else [place[None] for place in places]
    )
    return np.array([[*line[:, :2].min(axis=0), *line[:, :2].max(axis=0)] for line in lists], float)


@pytest.mark.parametrize(
    ("folder", "name"),
    [(TILE, "nsi"), (TILE, "esi"), (TILE, "fsi"), ("tileref", "esi"), ("tileref", "fsi"), ("tileref", "tsi")],
)
def test_real_spatial_indexes_find_their_primitives(folder, name):
    library = shared_vpf(TEXASH)
    data = (library / folder / name).read_bytes()
    boxes = boxes_of(library, folder, name)
    index = spatial_index.read(data, name)
    assert sorted(index.ids) == list(range(1, len(boxes) + 1))
    assert index.stray == 0
    for i, box in enumerate(boxes, 1):
        touching = {j for j, other in enumerate(boxes, 1) if touches(box, other)}
        assert i in touching <= set(index.search(box).tolist())
        assert i in walked(data, box)


def test_half_order_of_real_spatial_indexes():
    """V-302: of 63 entries below the first bin 62 lie in its place if the even child is right or above, one by a step."""
    library = shared_vpf(TEXASH)
    wrong = {}
    for first_axis in (0, 1):
        for is_even_high in (False, True):
            entries = [
                (place(number, first_axis, is_even_high), entry)
                for folder in (TILE, "tileref")
                for name in ("nsi", "esi", "fsi", "tsi")
                if (library / folder / name).exists()
                for number, bin_entries in enumerate(decoded((library / folder / name).read_bytes())[1], 1)
                for entry in bin_entries
                if number > 1
            ]
            outside = [
                not all(low[i] <= entry[i] and entry[i + 2] <= high[i] for i in (0, 1))
                for (low, high), entry in entries
            ]
            assert len(outside) == 63
            wrong[first_axis, is_even_high] = sum(outside)
    assert wrong == {(0, True): 1, (0, False): 62, (1, True): 41, (1, False): 38}


# Thematic indexes ---------------------------------------------------------------------------------------------------


def test_worked_thematic_index():
    """A table of four rows, as the page has it."""
    data = thematic_index.build(["BA010", "BH000", "BA010", "BA010"], "shore.lft", "f_code", "T", 5)
    header = struct.pack("<iiiccic12s25sc3s", 86, 2, 4, b"I", b"T", 5, b"S", b"shore.lft   ", b"f_code", b"S", b"")
    assert data[:60] == header
    assert data[60:] == (
        b"BA010" + struct.pack("<ii", 86, 3) + b"BH000" + struct.pack("<ii", 2, 0) + bytes.fromhex("01 00 03 00 04 00")
    )
    assert len(data) == 92


COLUMNS = st.one_of(
    st.tuples(st.just("I"), st.just(1), st.lists(st.integers(-(2**31), 2**31 - 1) | st.integers(0, 5), max_size=40)),
    st.tuples(st.just("S"), st.just(1), st.lists(st.integers(-(2**15), 2**15 - 1) | st.integers(0, 5), max_size=40)),
    st.tuples(st.just("F"), st.just(1), st.lists(st.floats(width=32), max_size=40)),
    st.tuples(st.just("T"), st.just(5), st.lists(st.text("aB 0é", max_size=5), max_size=40)),
    st.tuples(st.just("T"), st.just(1), st.lists(st.sampled_from("PLAT"), max_size=40)),
)


@settings(max_examples=60, deadline=None)
@given(COLUMNS)
def test_thematic_rows_are_those_of_a_dict(column):
    kind, count, values = column
    wanted = {}
    for row, value in enumerate(values, 1):
        key = value.rstrip() if kind == "T" else value
        key = "nan" if key != key else key
        wanted.setdefault(key, []).append(row)
    data = thematic_index.build(values, "road.lft", "col", kind, count)
    index = thematic_index.read(data)
    assert (index.table_name, index.column_name, index.n_row) == ("road.lft", "col", len(values))
    assert index.is_sorted
    assert index.is_rising
    assert {key: index.rows(float(key) if key == "nan" else key).tolist() for key in wanted} == wanted
    assert len(index.values) == len(wanted)
    assert index.rows("zz" if kind == "T" else 17).tolist() == wanted.get(17, [])
    assert sum(count == 0 for _, count in entries_of(data)) == sum(len(rows) == 1 for rows in wanted.values())


def entries_of(data):
    """Offset and count of each entry of a directory."""
    first, n_value = struct.unpack_from("<ii", data)
    size = (first - 60) // n_value if n_value else 0
    return [struct.unpack_from("<ii", data, 60 + size * (i + 1) - 8) for i in range(n_value)]


@pytest.mark.parametrize(("n_row", "letter", "size"), [(32_767, b"S", 2), (32_768, b"I", 4)])
def test_row_ids_take_what_they_need(n_row, letter, size):
    data = thematic_index.build(np.arange(n_row) % 2, "road.lft", "col", "S")
    assert data[18:19] == letter
    assert len(data) == 60 + 2 * 10 + size * n_row
    assert thematic_index.read(data).rows(1).tolist() == list(range(2, n_row + 1, 2))


@pytest.mark.parametrize(
    ("values", "kind", "count", "message"),
    [
        (["abcdef"], "T", 5, "'abcdef' of 6 characters, expected at most 5"),
        (["Ω"], "T", 5, "expected Latin-1"),
        ([1], "T", 5, "expected one text a row"),
        (["a"], "I", 1, "expected one number"),
        ([0.5], "I", 1, "expected one number"),
        ([40_000], "S", 1, "found values from 40000 to 40000, expected type S"),
        ([1], "R", 1, "expected one of: I, S, F, T"),
        ([1], "I", 2, "found 2 elements"),
        ([[1, 2]], "I", 1, "expected one number"),
    ],
)
def test_columns_that_are_not_indexed(values, kind, count, message):
    with pytest.raises(InputError, match=message):
        thematic_index.build(values, "road.lft", "col", kind, count)


@pytest.mark.parametrize(
    ("table", "column"), [("too_long.names", "col"), ("", "col"), ("road.lft", "é"), ("a", "c" * 25)]
)
def test_names_that_do_not_fit(table, column):
    with pytest.raises(InputError, match="found the name"):
        thematic_index.build([1], table, column, "I")


def test_values_of_another_type():
    index = thematic_index.read(thematic_index.build([1, 2], "road.lft", "col", "I"))
    with pytest.raises(InputError, match="col: found 'a', expected a number"):
        index.rows("a")
    assert index.rows(2**40).tolist() == []
    assert index.rows(1.5).tolist() == []


def header_of(index_type, kind, n_value, n_row, *, count=1, order="<", id_kind=b"S"):
    size = {"T": count, "I": 4, "S": 2}[kind] + 8
    return struct.pack(
        f"{order}iiiccic12s25sc3s", 60 + n_value * size, n_value, n_row, index_type, kind.encode(), count, id_kind,
        b"NAMES.TFT", b"NAME\0\4\0\0\x10", b" ", b"   ",
    )  # fmt: skip


def test_gazetteer_is_read():
    """Bit arrays of letters, the lowest bit first: rows 1, 9 and 10 have a b in their names."""
    head = header_of(b"G", "T", 2, 10)
    data = head + b"b" + struct.pack("<ii", 78, 1) + b"a" + struct.pack("<ii", 80, 1) + bytes([1, 3, 0xFF, 0xFF])
    index = thematic_index.read(data)
    assert (index.index_type, index.table_name, index.column_name) == ("G", "NAMES.TFT", "NAME")
    assert not index.is_sorted
    assert not index.is_rising
    assert index.rows("b").tolist() == [1, 9, 10]
    assert index.rows("a").tolist() == list(range(1, 11))
    assert index.rows("c").tolist() == []


def test_bit_arrays_are_read():
    head = header_of(b"B", "S", 3, 9)
    data = head + struct.pack("<hiihiihii", 4, 90, 2, 7, 3, 0, 9, 92, 1) + bytes([0b10, 0, 0, 1])
    index = thematic_index.read(data)
    assert [index.rows(value).tolist() for value in (4, 7, 9)] == [[2], [3], [9]]


def test_thematic_index_of_the_other_byte_order():
    head = header_of(b"I", "I", 2, 300, order=">", id_kind=b"I")
    data = head + struct.pack(">iiiiii2i", 5, 84, 2, 6, 300, 0, 1, 2)
    assert [thematic_index.read(data).rows(value).tolist() for value in (5, 6)] == [[1, 2], [300]]


SMALL_THEMATIC = {
    "lists": thematic_index.build(["a", "b", "a", "cc", "b"], "road.lft", "col", "T", 2),
    "numbers": thematic_index.build([3, 3, 3, 1], "road.lft", "col", "I"),
    "bits": header_of(b"B", "S", 2, 9) + struct.pack("<hiihii", 4, 80, 2, 7, 82, 2) + bytes([1, 0, 2, 1]),
}


def judge_thematic(data):
    """A broken index is refused, or answers with rows of the table."""
    try:
        index = thematic_index.read(data, "col.lti")
    except VpfFormatError:
        return
    for value in index.values[:3].tolist():
        rows = index.rows(value)
        assert all((rows >= 1) & (rows <= index.n_row))


@pytest.mark.parametrize("name", SMALL_THEMATIC)
def test_thematic_index_cut_at_every_byte(name):
    for n in range(len(SMALL_THEMATIC[name])):
        with pytest.raises(VpfFormatError):
            thematic_index.read(SMALL_THEMATIC[name][:n])


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_thematic_index_with_changed_bytes(data):
    changed = bytearray(SMALL_THEMATIC[data.draw(st.sampled_from(sorted(SMALL_THEMATIC)))])
    for _ in range(data.draw(st.integers(1, 3))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    judge_thematic(bytes(changed))


@pytest.mark.parametrize(
    ("at", "number", "message"),
    [
        (4, 2**31 - 1, "header: found 2147483647 values"),
        (4, -1, "header: found -1 values"),
        (8, -1, "values of -1 rows"),
        (8, 2, "found row 5, expected rows from 1 to 2"),
        (14, 2**31 - 1, "header: found 2147483647 elements"),
        (14, 0, "header: found 0 elements"),
        (0, 61, "data from byte 61"),
        (62, 2**31 - 4, "directory: found 4 bytes of rows"),
        (62, 0, "directory: found 4 bytes of rows at byte 0"),
        (66, 2**31 - 1, "directory: found 4294967294 bytes"),
        (66, -1, "directory: found -2 bytes"),
    ],
)
def test_numbers_in_a_thematic_index_are_bounded(at, number, message):
    changed = bytearray(SMALL_THEMATIC["lists"])
    struct.pack_into("<i", changed, at, number)
    with pytest.raises(VpfFormatError, match=message):
        thematic_index.read(bytes(changed))


def test_lists_that_share_their_bytes_are_refused():
    """Else a small file could ask for much memory."""
    entries = b"".join(struct.pack("<iii", value, 1260, 500) for value in range(100))
    data = header_of(b"I", "I", 100, 1000) + entries + struct.pack("<500h", *range(1, 501))
    with pytest.raises(VpfFormatError, match="found 100000 bytes of rows, expected at most 1000"):
        thematic_index.read(data)
    entries = b"".join(struct.pack("<iii", value, 1260, 1) for value in range(100))
    with pytest.raises(VpfFormatError, match="found 12500 bytes of rows, expected at most 125"):
        thematic_index.read(header_of(b"B", "I", 100, 1000) + entries + bytes(125))


def test_real_thematic_indexes_agree_with_their_tables():
    folder = shared_vpf(f"{TEXASH}/bnd")
    paths = sorted(folder.glob("*.?ti"))
    assert len(paths) == 10
    for path in paths:
        index = thematic_index.read(path.read_bytes(), path.name)
        column = read_table(folder / index.table_name)[index.column_name]
        assert index.n_row == len(column)
        assert index.is_sorted
        assert index.is_rising
        wanted = {}
        for row, value in enumerate(column.tolist(), 1):
            wanted.setdefault(value, []).append(row)
        assert sorted(wanted) == index.values.tolist()
        assert {value: index.rows(value).tolist() for value in wanted} == wanted
