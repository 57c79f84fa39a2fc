"""Headers of VPF tables: those of other writers, those that break the grammar, layouts that are not written."""

from __future__ import annotations

import pytest
from vpf_oracle import table_of

from vpfx.errors import InputError, VpfFormatError
from vpfx.vpf.table import Column, Layout, decode, encode

ID = Column("id", "I", 1, "P", "Row id")

# --- headers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [b"L", b"l", b"", b"M", b"m"])
def test_letter_of_the_order(order):
    number = b"\0\0\0\7" if order in (b"M", b"m") else b"\7\0\0\0"
    table = decode(table_of(b"ID=I,1,P,Row id,-,-,-,:", order, number))
    assert table["id"].tolist() == [7]
    assert table.layout.order == (">" if order in (b"M", b"m") else "<")
    assert table.layout.columns[0].name == "ID"


@pytest.mark.parametrize(
    ("text", "column"),
    [
        (b"a=T,8,N,About,int.vdt,a.lti,a.doc,:", Column("a", "T", 8, "N", "About", "int.vdt", "a.lti", "a.doc")),
        (b"a=T,8,N,About,int.vdt,a.lti,:", Column("a", "T", 8, "N", "About", "int.vdt", "a.lti")),
        (b"a=T,8,N,About,int.vdt,:", Column("a", "T", 8, "N", "About", "int.vdt")),
        (b"a=T,8,N,About:", Column("a", "T", 8, "N", "About")),
        (b"a=T,8,F:", Column("a", "T", 8, "F")),
        (b"a=T,8,:", Column("a", "T", 8)),
        (b"a=T 8,N,About,-,-,:", Column("a", "T", 8, "N", "About")),  # once in DCW
        (b" a = t , 8 , PK , About , - , - , :", Column("a", "T", 8, "PK", "About")),
        (b"a=T,8,N,On\\, or\\: off\\\\,-,-,-,:", Column("a", "T", 8, "N", "On, or: off\\")),
        (b"a=T,8,N,On, or off,-,-,-,:", Column("a", "T", 8, "N", "On, or off")),
        (b"a=T,8,N,,,,,:", Column("a", "T", 8)),
    ],
)
def test_columns_of_other_writers(text, column):
    assert decode(table_of(b"id=I,1,P,Row id,-,-,-,:" + text)).layout.columns[1] == column


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (b"id=I,1,P,:id=I,1,N,:", "found two columns 'id', expected one of a name (V-103)"),
        (b"id=I,1,P,:ID=I,1,N,:", "found two columns 'id', expected one of a name (V-103)"),
        (b"id=Q,1,P,:", "found type 'Q', expected one of T L N M F R S I C B Z Y D K X (V-110)"),
        (b"id=I,0,P,:", "found count '0', expected 1 to 2000000 or * (V-111)"),
        (b"id=I,-1,P,:", "found count '-1', expected 1 to 2000000 or * (V-111)"),
        (b"id=I,2000001,P,:", "found count '2000001', expected 1 to 2000000 or * (V-111)"),
        (b"id=I,\xb2,P,:", "found count '\xb2', expected 1 to 2000000 or * (V-111)"),
        (b"id=K,2,P,:", "found K,2, expected K,1 (V-111)"),
        (b"id=X,*,P,:", "found X,*, expected X,1 (V-111)"),
        (b"id=X,1,P,:", "found rows of 0 bytes, expected 1 to 2147483647 (V-103)"),
        (b"id=I:", "found column 'id=I', expected name=type,count,key,description,… (V-102)"),
        (b"=I,1,P,:", "found column '=I,1,P,', expected name=type,count,key,description,… (V-102)"),
        (b"", "found 0 columns, expected 1 to 1000 (V-103)"),
        (b"".join(b"a%d=I,1,N,:" % i for i in range(1001)), "found 1001 columns, expected 1 to 1000 (V-103)"),
        (b"".join(b"a%d=Y,2000000,N,:" % i for i in range(50)), "found rows of 2400000000 bytes, expected 1 to"),
        (b"id=I,1,P,:;", "found 5 semicolons, expected order;description;narrative;columns; and nothing behind"),
    ],
)
def test_headers_that_break_the_grammar(columns, message):
    with pytest.raises(VpfFormatError) as error:
        decode(table_of(columns), path="edg")
    assert str(error.value).startswith("edg: header: ") or str(error.value).startswith("edg: column")
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "found a file of 0 bytes, expected at least 8"),
        (b"\x64\0\0\0L;", "found a file of 6 bytes, expected at least 8"),
        (b"\x64\0\0\0X;a;b;", "found byte b'X' for the byte order, expected L, M or ;"),
        (b"\x64\0\0\0L;a;b;", "found a length of 100 bytes after letter 'L', expected 4 to 6 in a file of 10"),
        (b"\xff\xff\xff\xffL;a;b;", "found a length of -1 bytes"),
        (b"\x06\0\0\0M;a;b;", "in the other byte order the length would fit, so the letter may be wrong"),
        (b"\0\0\0\x06L;a;b;", "in the other byte order the length would fit, so the letter may be wrong"),
    ],
)
def test_starts_that_are_no_table(data, message):
    with pytest.raises(VpfFormatError) as error:
        decode(data, path="edg")
    assert str(error.value).startswith("edg: header: ")
    assert message in str(error.value)
    assert str(error.value).endswith("(V-101)")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"description": "a;b"}, "description: found 'a;b'"),
        ({"description": "é"}, "description: found 'é'"),
        ({"description": "x" * 81}, "description: found 81 characters, expected at most 80"),
        ({"narrative": "thirteen.char"}, "narrative: found 13 characters, expected at most 12"),
        ({"order": "L"}, "found byte order 'L'"),
        ({"columns": ()}, "`id` first"),
        ({"columns": (Column("name", "T"),)}, "`id` first"),
        ({"columns": (ID, Column("ID", "I"))}, "found two columns 'id'"),
        ({"columns": (ID._replace(kind="X"),)}, "found rows of 0 bytes"),
        ({"columns": (ID, *(Column(f"a{i}", "Y", 2_000_000) for i in range(50)))}, "found rows of 2400000004 bytes"),
    ],
)
def test_layouts_that_are_not_written(change, message):
    with pytest.raises(InputError) as error:
        encode(Layout("Made up", (ID,))._replace(**change), {"id": []})
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "seventeen_letters"}, "name: found 17 characters, expected at most 16"),
        ({"name": "a b"}, "found that name, expected one without blanks"),
        ({"name": ""}, "found that name, expected one without blanks"),
        *(({"description": f"a{sign}b"}, f"description: found {'a' + sign + 'b'!r}") for sign in ';:,=\\"#\n'),
        ({"value_table": "thirteen.char"}, "value_table: found 13 characters, expected at most 12"),
        ({"index": "a,b"}, "index: found 'a,b'"),
        ({"narrative": "ä.doc"}, "narrative: found 'ä.doc'"),
        ({"kind": "N"}, "found type 'N', expected one of T L F R S I C B Z Y D K X"),
        ({"kind": "G"}, "found type 'G'"),
        ({"key": "F"}, "found key 'F', expected P, U or N"),
        ({"key": ""}, "found key '', expected P, U or N"),
        ({"count": 0}, "found count 0"),
        ({"count": 2_000_001}, "found count 2000001"),
        ({"kind": "I", "count": 2}, "found several elements of type I, expected one"),
        ({"kind": "K", "count": -1}, "found several elements of type K, expected one"),
    ],
)
def test_columns_that_are_not_written(change, message):
    with pytest.raises(InputError) as error:
        encode(Layout("Made up", (ID, Column("a", "T", 8)._replace(**change))), {"id": [], "a": []})
    assert message in str(error.value)


def test_a_missing_column_is_told():
    table = decode(table_of(b"id=I,1,P,:"), path="fcs")
    assert "ID" in table
    assert "fcid" not in table
    with pytest.raises(VpfFormatError, match="fcs: column 'fcid': found none, expected one beside id"):
        table["fcid"]
