"""VPF tables: bytes to arrays and back, against worked values and an independent decoder."""

from __future__ import annotations

import numpy as np

from vpfx.vpf.table import Column, Layout, decode, encode

RING_HEADER = b"L;Ring Table;-;id=I,1,P,Row id,-,-,-,:face_id=I,1,N,Face,-,-,-,:start_edge=I,1,N,First edge,-,-,-,:;"
RING_ROWS = "01 00 00 00  01 00 00 00  02 00 00 00  02 00 00 00  02 00 00 00  02 00 00 00"


def test_worked_ring_table():
    columns = (
        Column("id", "I", 1, "P", "Row id"),
        Column("face_id", "I", 1, "N", "Face"),
        Column("start_edge", "I", 1, "N", "First edge"),
    )
    data, index = encode(Layout("Ring Table", columns), {"id": [1, 2], "face_id": [1, 2], "start_edge": [2, 2]})
    assert data == b"\x64\0\0\0" + RING_HEADER + bytes.fromhex(RING_ROWS)
    assert index is None
    assert decode(data)["start_edge"].tolist() == [2, 2]


def test_worked_index():
    layout = Layout("Edge", (Column("id", "I", 1, "P", "Row id"), Column("right_face", "K", 1, "N", "Face")))
    data, index = encode(layout, {"id": [1, 2], "right_face": np.array([(2, 0, 0), (300, 4, 9)])})
    assert data[-15:] == bytes.fromhex("01 00 00 00 40 02            02 00 00 00 94 2C 01 04 09")
    first = len(data) - 15
    assert index == np.array([2, first, first, 6, first + 6, 9], "<u4").tobytes()
    for given in (index, None):
        assert decode(data, given)["right_face"].tolist() == [[2, 0, 0], [300, 4, 9]]
