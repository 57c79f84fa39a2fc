"""Values of VPF tables: nulls, texts, dates, descriptions, and what is refused in their place."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest
from conftest import shared_vpf
from hypothesis import given
from hypothesis import strategies as st

from vpfx.errors import InputError, VpfFormatError
from vpfx.vpf.schema import value_descriptions
from vpfx.vpf.table import Column, Layout, Ragged, decode, encode, read_table
from vpfx.vpf.values import (
    NULL_DATE,
    NULL_INT,
    NULL_SHORT,
    date_text,
    is_null,
    parse_date,
    ragged,
    texts,
)

ID = Column("id", "I", 1, "P", "Row id")


def written(kind, values, count=1):
    """A column as it is read after it was written."""
    columns = {"id": range(len(values)), "a": values}
    return decode(*encode(Layout("Made up", (ID, Column("a", kind, count))), columns))["a"]


@pytest.mark.parametrize(
    ("kind", "count", "null"),
    [
        ("T", 1, b"-"), ("T", 2, b"--"), ("T", 3, b"N/A"), ("T", 6, b"N/A   "), ("L", 5, b"N/A  "),
        ("S", 1, -32768), ("I", 1, -(2**31)), ("F", 1, np.nan), ("R", 1, np.nan), ("D", 1, b" " * 20),
        ("K", 1, [0, 0, 0]), ("C", 1, [np.nan] * 2), ("B", 1, [np.nan] * 2), ("Z", 1, [np.nan] * 3),
        ("Y", 2, [[np.nan] * 3] * 2),
    ],
)  # fmt: skip
def test_nulls_are_those_of_the_page(kind, count, null):
    column = written(kind, [None, None], count)
    np.testing.assert_array_equal(column[1], null)
    assert is_null(column, kind).tolist() == [True, True]


@pytest.mark.parametrize(("kind", "width"), [("T", 0), ("L", 0), ("C", 2), ("B", 2), ("Z", 3), ("Y", 3)])
def test_rows_of_nothing_are_null(kind, width):
    some = "text" if not width else [[0.5] * width]
    column = written(kind, [None, some, [] if width else ""], -1)
    assert is_null(column, kind).tolist() == [True, False, True]
    assert is_null(np.empty((2, 0), np.uint8), "X").tolist() == [True, True]


@pytest.mark.parametrize(
    ("kind", "values", "nulls"),
    [
        ("S", np.array([-32768, -32767, -32766, 0], "i2"), [1, 1, 0, 0]),
        ("I", np.array([-(2**31), -(2**31) + 1, -(2**31) + 2, 0], "i4"), [1, 1, 0, 0]),
        ("T", np.array([b"N/A  ", b"-    ", b" --  ", b"     ", b"---  ", b"n/a  ", b"\0\0"]), [1, 1, 1, 1, 0, 0, 1]),
        ("D", np.array([b" " * 20, b"19991105000000.00000"]), [1, 0]),
        ("F", np.array([np.nan, np.inf, 0], "f4"), [1, 0, 0]),
        ("C", np.array([[np.nan, np.nan], [np.nan, 1]], "f4"), [1, 0]),
        ("K", np.array([[0, 0, 0], [0, 0, 1]]), [1, 0]),
        ("S", np.array([[-32768, -32767], [-32768, 0]], "i2"), [1, 0]),
        ("T", np.empty(0, "S4"), []),
    ],
)
def test_nulls_of_other_writers(kind, values, nulls):
    assert is_null(values, kind).tolist() == list(map(bool, nulls))


def test_texts():
    assert texts(written("L", ["Süß", " left", "N/A", "", "é\0", b"\xe9"], 5)) == ["Süß", " left", None, None, "é", "é"]
    assert texts(written("L", ["Süß  ", None, "-", "", b"a"], -1)) == ["Süß", None, "-", None, "a"]
    assert texts(written("T", [], -1)) == []
    assert texts(written("T", [], 4)) == []


def test_texts_of_arrays():
    for values in (np.array(["ab", "c"]), np.array([b"ab", b"c"]), np.array(["ab", "c"], ">U7")):
        assert written("T", values, 3).tolist() == [b"ab ", b"c  "]


def test_latin_1_is_read_in_t():
    data, _ = encode(Layout("Made up", (ID, Column("a", "L", 3))), {"id": [1], "a": ["Süß"]})
    assert texts(decode(data.replace(b"=L,3", b"=T,3"))["a"]) == ["Süß"]


@pytest.mark.parametrize(
    ("kind", "count", "values", "message"),
    [
        (
            "T",
            3,
            ["abcd"],
            "row 1: found 'abcd', expected at most 3 characters of ASCII (type L takes Latin-1) (V-113)",
        ),
        ("T", 3, ["a", "é"], "row 2: found 'é', expected at most 3 characters of ASCII"),
        ("L", 3, ["a", "Ω"], "row 2: found 'Ω', expected characters of Latin-1 (V-113)"),
        ("T", 3, ["a", 1], "found values that are no texts, expected 2 texts (V-117)"),
        ("T", 3, np.array([1]), "found an array of int64 (1,), expected texts (1,) (V-117)"),
        ("T", -1, ["a", "é"], "row 2: found a character beyond ASCII, which type L takes (V-113)"),
        ("L", -1, ["a", "Ω"], "row 2: found 'Ω', expected characters of Latin-1"),
        ("S", 1, [1, 32768], "row 2: found 32768, expected -32768 … 32767 (V-117)"),
        ("I", 1, [2**31], "row 1: found 2147483648, expected -2147483648 … 2147483647 (V-117)"),
        ("I", 1, [2**70], "(V-117)"),
        ("I", 1, [1.0], "found values of type float64, expected int32 (V-117)"),
        ("I", 1, [True], "found values of type bool, expected int32 (V-117)"),
        ("I", 1, ["1"], "found values of type <U1, expected int32 (V-117)"),
        ("F", 1, [1e39], "found numbers beyond those of 32 bits"),
        ("C", -1, [[(1e39, 0)]], "found numbers beyond those of 32 bits"),
        ("F", 1, [[1.0]], "found an array of shape (1, 1), expected (1,) (V-117)"),
        ("C", 1, [(1, 2, 3)], "found an array of shape (1, 3), expected (1, 2) (V-117)"),
        ("C", 2, [[(1, 2)]], "found an array of shape (1, 1, 2), expected (1, 2, 2) (V-117)"),
        ("C", 1, [(1, 2), (1, 2, 3)], "(V-117)"),
        ("C", -1, [[(1, 2, 3)]], "found rows that are not arrays (n, 2)"),
        ("K", 1, [-1], "row 1: found [-1  0  0], expected 0 … 4294967295 (V-117)"),
        ("K", 1, [(1, 2**32, 0)], "expected 0 … 4294967295 (V-117)"),
        ("D", 1, ["1999-11-05T00:00:00.000"], "expected at most 20 characters"),
        ("I", 1, 7, "found int, expected rows (V-117)"),
        ("I", 1, [1, 2], "found 2 rows, expected 1 (V-117)"),
        ("I", 1, Ragged(np.array([0, 1]), np.array([1])), "found rows of different lengths, expected 1 elements each"),
        ("C", -1, Ragged(np.array([0, 2]), np.zeros((1, 2))), "found starts of rows that do not ascend from 0 to 1"),
        ("C", -1, Ragged(np.array([1, 1]), np.zeros((1, 2))), "found starts of rows that do not ascend from 0 to 1"),
        ("C", -1, Ragged(np.array([0, 1]), np.zeros((1, 3))), "found an array of shape (1, 3), expected (n, 2)"),
        ("T", -1, Ragged(np.array([0, 1]), np.array(["a"])), "found <U1 (1,), expected uint8 (n,)"),
        ("C", -1, [np.zeros((2_000_001, 2), "f4")], "row 1: found 2000001 elements, expected at most 2000000 (V-111)"),
    ],
)
def test_values_that_are_refused(kind, count, values, message):
    n_row = 1 if message.startswith("found 2 rows") else len(values) if isinstance(values, list) else 1
    with pytest.raises(InputError) as error:
        encode(Layout("Made up", (ID, Column("a", kind, count))), {"id": range(n_row), "a": values})
    assert str(error.value).startswith("table: column 'a': ")
    assert message in str(error.value)


@pytest.mark.parametrize("columns", [{}, {"id": [1]}, {"id": [1], "a": [1], "b": [1]}])
def test_columns_that_are_not_those_of_the_layout(columns):
    with pytest.raises(InputError, match=r"found columns .*, expected \['id', 'a'\] \(V-117\)"):
        encode(Layout("Made up", (ID, Column("a", "I"))), columns)


def test_null_columns_need_no_values():
    layout = Layout("Made up", (ID, Column("a", "X")))
    for extra in ({}, {"A": [None, None]}):
        data, _ = encode(layout, {"ID": [1, 2], **extra})
        assert decode(data)["a"].shape == (2, 0)


def test_ids_alone_are_triplets():
    assert written("K", [5, None]).tolist() == [[5, 0, 0], [0, 0, 0]]
    assert written("K", [(5, 1, 2), None]).tolist() == [[5, 1, 2], [0, 0, 0]]
    assert written("K", np.array([5, 2**32 - 1], np.uint64)).tolist() == [[5, 0, 0], [2**32 - 1, 0, 0]]


def test_arrays_of_any_order_and_layout_are_written():
    places = np.arange(12, dtype=">f8").reshape(2, 6).T[::2]
    assert written("C", places).tolist() == places.tolist()
    assert written("S", np.arange(10, dtype=np.int64)[::3]).tolist() == [0, 3, 6, 9]
    read_only = np.arange(6)
    read_only.flags.writeable = False
    assert written("K", read_only.reshape(2, 3)).tolist() == [[0, 1, 2], [3, 4, 5]]
    assert read_only.tolist() == list(range(6))


def test_what_is_given_is_not_changed():
    lines = ragged([[(1.0, 2.0)], None], 2)
    lines = Ragged(lines.starts, lines.values.astype(np.float32))
    for order in "<>":
        encode(
            Layout("Made up", (ID, Column("a", "C", -1), Column("b", "R")), order=order),
            {"id": np.array([1, 2], np.int32), "a": lines, "b": np.array([1.5, 2.5])},
        )
    assert lines.values.tolist() == [[1.0, 2.0]]


# --- dates ------------------------------------------------------------------------------------------------------------


@given(st.datetimes(min_value=dt.datetime(1, 1, 1)))
def test_dates_come_back(when):
    text = date_text(when)
    assert len(text) == 20
    assert parse_date(text) == when.replace(microsecond=0)


@pytest.mark.parametrize(
    ("text", "when"),
    [
        ("19991105000000.00000", dt.datetime(1999, 11, 5)),  # DNC 13
        ("19890000000000.00000", dt.datetime(1989, 1, 1)),  # DCW
        ("199311            ", dt.datetime(1993, 11, 1)),
        ("1993                ", dt.datetime(1993, 1, 1)),
        ("19991105123456.+0130", dt.datetime(1999, 11, 5, 12, 34, 56, tzinfo=dt.timezone(dt.timedelta(hours=1.5)))),
        ("19991105123456.-0500", dt.datetime(1999, 11, 5, 12, 34, 56, tzinfo=dt.timezone(-dt.timedelta(hours=5)))),
        (b"19991105000000.00000", dt.datetime(1999, 11, 5)),
        (" " * 20, None),
        ("00000000000000.00000", None),
        ("", None),
        (None, None),
    ],
)
def test_dates_are_parsed(text, when):
    assert parse_date(text) == when


@pytest.mark.parametrize(
    "text", ["19991305000000.00000", "19990230000000.00000", "1999110525", "N/A", "abcdefgh", "²⁰¹¹"]
)
def test_texts_that_are_no_dates(text):
    with pytest.raises(VpfFormatError, match=r"found date .*, expected YYYYMMDDHHMMSS.ZZZZZ \(V-114\)"):
        parse_date(text)


def test_dates_are_written():
    aware = dt.datetime(1999, 11, 5, 1, tzinfo=dt.timezone(dt.timedelta(hours=2)))
    column = written("D", [dt.date(1999, 11, 5), aware, None, "19890000000000.00000"])
    assert column.tolist() == [
        b"19991105000000.00000", b"19991104230000.00000", NULL_DATE.encode(), b"19890000000000.00000",
    ]  # fmt: skip


def test_real_dates():
    found = [
        parse_date(text)
        for name in ("dnc13_coa/dht", "vm2alv2_texash/dht", "vm2alv2_texash/texash/dqt")
        for column in read_table(shared_vpf(name)).columns.values()
        if not isinstance(column, Ragged) and column.dtype == "S20"
        for text in column.tolist()
        if text[:1] in b" 12"
    ]
    assert dt.datetime(1999, 11, 5) in found
    assert dt.datetime(1993, 11, 15) in found  # told with fifteen digits before the point
    assert dt.datetime(1976, 1, 1) in found
    assert None in found


# --- descriptions -----------------------------------------------------------------------------------------------------


def test_real_values_are_described():
    folder = shared_vpf("vm2alv2_texash/texash/bnd/int.vdt").parent
    numbers, letters = (value_descriptions(read_table(folder / name)) for name in ("int.vdt", "char.vdt"))
    assert sum(map(len, numbers.values())) == 38
    assert sum(map(len, letters.values())) == 25
    assert letters["markersp.pft", "f_code"]["AL025"] == "Cairn"
    assert ("polbndl.lft", "acc") in numbers


def test_the_first_description_counts():
    columns = {
        "TABLE": ["a.lft", "A.LFT", "a.lft"], "attribute": ["acc", "ACC", "hdp"], "value": [1, 1, NULL_INT],
        "description": ["first", "second", None], "id": [1, 2, 3],
    }  # fmt: skip
    layout = Layout("Values", (ID, *(Column(name, "T", 8) for name in ("table", "attribute")), Column("value", "I"),
                               Column("description", "T", -1)))  # fmt: skip
    table = decode(*encode(layout, columns))
    assert value_descriptions(table) == {("a.lft", "acc"): {1: "first"}, ("a.lft", "hdp"): {NULL_INT: ""}}
    rows = {name: column for name, column in columns.items() if name != "value"}
    table = decode(*encode(layout._replace(columns=layout.columns[:3] + layout.columns[4:]), rows))
    with pytest.raises(VpfFormatError, match="column 'value': found none"):
        value_descriptions(table)


def test_null_constants():
    assert (NULL_SHORT, NULL_INT, len(NULL_DATE)) == (-32768, -2147483648, 20)
