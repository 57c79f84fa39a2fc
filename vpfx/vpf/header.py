"""What the header of a table says, as text and as a Layout.

    M;Edge Primitives;-;id=I,1,P,Row id,-,-,-,:start_node=I,1,N,Start node,-,-,-,:;
    │ └ description   │ └ a column: name=kind,count,key,description,value table,thematic index,narrative,:
    └ byte order      └ narrative table

Source: specs/vpf.md, V-101 to V-112.
"""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

from vpfx.errors import InputError, VpfFormatError

__all__ = [
    "COUNTED",
    "KINDS",
    "MOST_COLUMNS",
    "MOST_COUNT",
    "MOST_HEADER",
    "MOST_ROW",
    "TEXT_KINDS",
    "Column",
    "Kind",
    "Layout",
    "check_layout",
    "header_bytes",
    "header_size",
    "parse_header",
]

COUNTED = -1
"""The count `*`: each row says how many elements follow."""

MOST_HEADER = 1 << 18  # bytes: what `MOST_COLUMNS` of the widest take; the longest header seen has 1 351
MOST_COLUMNS = 1000  # the most seen are 40
MOST_COUNT = 2_000_000  # elements of one column of a row: OGDI refuses more
MOST_ROW = 2**31 - 1  # bytes of a row of fixed length: what a NumPy record can have


class Kind(NamedTuple):
    """What one element of a column is."""

    member: str  # NumPy type of its numbers, without byte order; "S1" and "S20" for text, "" for nothing and triplets
    n_member: int  # numbers of one element: 2 or 3 for coordinates
    size: int  # bytes of one element


KINDS = {
    "T": Kind("S1", 1, 1),
    "L": Kind("S1", 1, 1),
    "N": Kind("S1", 1, 1),
    "M": Kind("S1", 1, 1),
    "F": Kind("f4", 1, 4),
    "R": Kind("f8", 1, 8),
    "S": Kind("i2", 1, 2),
    "I": Kind("i4", 1, 4),
    "C": Kind("f4", 2, 8),
    "B": Kind("f8", 2, 16),
    "Z": Kind("f4", 3, 12),
    "Y": Kind("f8", 3, 24),
    "D": Kind("S20", 1, 20),
    "K": Kind("", 3, 0),
    "X": Kind("", 0, 0),
}
"""Column types by letter (V-110)."""

TEXT_KINDS = "TLNM"
_ARRAY_KINDS = "TLCBZY"  # other readers take several elements of these alone
_NOT_WRITTEN = "NM"  # OGDI refuses the whole table
_KEYS = "PUN"
_HIDDEN = 0xE000
_ByteOrder = Literal["little", "big"]
_SPECIAL = set(';:,=\\"#')
_LIMITS = {"name": 16, "description": 80, "value_table": 12, "index": 12, "narrative": 12}


class Column(NamedTuple):
    """One column of a table, as its header has it.

    Examples
    --------
    >>> Column("first_edge", "I")
    Column(name='first_edge', kind='I', count=1, key='N', description='', value_table='-', index='-', narrative='-')
    """

    name: str  # as in the file; compared without case
    kind: str  # T L N M F R S I C B Z Y D K X
    count: int = 1  # type: ignore[assignment]  # hides tuple.count; elements; -1 is `*`
    key: str = "N"  # P primary, U unique, N neither; F, foreign, is read too
    description: str = ""
    value_table: str = "-"  # int.vdt, char.vdt
    index: str = "-"  # type: ignore[assignment]  # hides tuple.index; thematic index
    narrative: str = "-"

    @property
    def is_variable(self) -> bool:
        """Whether the bytes it takes differ from row to row."""
        return self.count == COUNTED or self.kind == "K"

    @property
    def size(self) -> int:
        """Bytes it takes in each row, at least where that varies: 4 of a count, 1 of a triplet."""
        if self.kind == "K":
            return 1
        return 4 if self.count == COUNTED else KINDS[self.kind].size * self.count


class Layout(NamedTuple):
    """What a header says.

    Examples
    --------
    >>> layout = Layout("Rings", (Column("id", "I", 1, "P"), Column("face_id", "I")))
    >>> layout.is_variable, layout.row_size, layout.find("FACE_ID").kind
    (False, 8, 'I')
    """

    description: str
    columns: tuple[Column, ...]
    narrative: str = "-"
    order: str = "<"  # "<" (L, least significant byte first) or ">" (M)

    @property
    def is_variable(self) -> bool:
        """Whether rows differ in length: any `*` count or any K; such a table has an index file."""
        return any(column.is_variable for column in self.columns)

    @property
    def row_size(self) -> int:
        """Bytes of a row, of the shortest one where they differ."""
        return sum(column.size for column in self.columns)

    def find(self, name: str) -> Column | None:
        """Return the column of a name, whatever its case, or None."""
        return next((column for column in self.columns if column.name.lower() == name.lower()), None)


def header_size(start: bytes, size: int, path: str = "") -> tuple[str, int]:
    r"""Return byte order and offset of the first row from the first five bytes of a table.

    Parameters
    ----------
    start : bytes (5,)
        The length in the table's own byte order, and the letter that tells that order.
    size : int
        Bytes of the file.
    path : str, optional
        What messages call the file.

    Raises
    ------
    VpfFormatError
        There are fewer bytes, another letter, or a length that the file does not have (V-101).

    Examples
    --------
    >>> header_size(b"dddd", 4, "edg")
    Traceback (most recent call last):
    vpfx.errors.VpfFormatError: edg: header: found a file of 4 bytes, expected at least 8 (V-101)
    >>> header_size(b"\x64\0\0\0L", 128)
    ('<', 104)
    """
    if size < 8 or len(start) < 5:
        raise _broken(path, f"found a file of {size} bytes, expected at least 8", "V-101")
    letter = start[4:5].upper()
    if letter not in (b"L", b"M", b";"):
        raise _broken(path, f"found byte {start[4:5]!r} for the byte order, expected L, M or ;", "V-101")
    order = ">" if letter == b"M" else "<"
    length, other = (int.from_bytes(start[:4], byteorder, signed=True) for byteorder in _orders(order))
    most = min(size - 4, MOST_HEADER)
    if not 4 <= length <= most:
        hint = (
            "; in the other byte order the length would fit, so the letter may be wrong" if 4 <= other <= most else ""
        )
        found = f"found a length of {length} bytes after letter {letter.decode()!r}"
        raise _broken(path, f"{found}, expected 4 to {most} in a file of {size}{hint}", "V-101")
    return order, 4 + length


def parse_header(text: bytes, order: str, path: str = "") -> Layout:
    """Return what the text of a header says.

    Parameters
    ----------
    text : bytes
        From the letter of the byte order, or the semicolon, to the last semicolon.
    order : str
        "<" or ">".
    path : str, optional
        What messages call the file.

    Raises
    ------
    VpfFormatError
        The text breaks the grammar (V-102), or goes past a limit (V-103).

    Examples
    --------
    >>> parse_header(b"L;Rings;-;id=I,1,P,Row id,-,-,-,:;", "<").columns[0].description
    'Row id'
    """
    pieces = _hide(text.decode("latin-1")).split(";")
    if len(pieces) != 5 or pieces[4].strip(" \0\r\n\t") or pieces[0].strip().upper() not in ("", "L", "M"):
        wanted = "order;description;narrative;columns; and nothing behind"
        raise _broken(path, f"found {len(pieces) - 1} semicolons, expected {wanted}", "V-102")
    _, description, narrative, columns, _ = pieces
    texts = [piece for piece in columns.split(":") if piece.strip(" \0\r\n\t")]
    if not 1 <= len(texts) <= MOST_COLUMNS:
        raise _broken(path, f"found {len(texts)} columns, expected 1 to {MOST_COLUMNS}", "V-103")
    layout = Layout(
        _plain(description), tuple(_parse_column(piece, path) for piece in texts), _name(_plain(narrative)), order
    )
    names = [column.name.lower() for column in layout.columns]
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise _broken(path, f"found two columns {twice!r}, expected one of a name", "V-103")
    if not 1 <= layout.row_size <= MOST_ROW:
        raise _broken(path, f"found rows of {layout.row_size} bytes, expected 1 to {MOST_ROW}", "V-103")
    return layout


def _parse_column(text: str, path: str) -> Column:
    """Return the column that one definition describes."""
    name, equals, rest = text.partition("=")
    name = _plain(name)
    fields = rest.split(",")
    head = fields[0].split()
    if len(head) == 2:  # a blank in the place of the comma, as once in DCW
        fields[:1] = head
    if not _plain(fields[-1]):
        fields.pop()
    if not equals or not name or len(fields) < 2:
        raise _broken(path, f"found column {text[:80]!r}, expected name=type,count,key,description,…", "V-102")
    if len(fields) > 7:  # commas in the description
        fields[3:-3] = [",".join(fields[3:-3])]
    fields = [_plain(field) for field in fields]
    fields += ["N", "", "-", "-", "-"][len(fields) - 2 :]
    kind, count, key, description, *names = fields
    kind, where = kind.upper(), f"column {name!r}"
    if kind not in KINDS:
        raise VpfFormatError(path, where, f"found type {kind[:20]!r}, expected one of {' '.join(KINDS)}", "V-110")
    is_number = re.fullmatch("[0-9]{1,9}", count) is not None
    if count != "*" and not (is_number and 1 <= int(count) <= MOST_COUNT):
        raise VpfFormatError(path, where, f"found count {count[:20]!r}, expected 1 to {MOST_COUNT} or *", "V-111")
    if (kind in "DK" and count != "1") or (kind == "X" and count == "*"):
        raise VpfFormatError(path, where, f"found {kind},{count}, expected {kind},1", "V-111")
    return Column(name, kind, COUNTED if count == "*" else int(count), key or "N", description, *map(_name, names))


def _hide(text: str) -> str:
    """Return a text whose characters behind a backslash are no separators: they are moved out of Latin-1 (V-102)."""
    return re.sub(r"\\(.)", lambda match: chr(_HIDDEN + ord(match[1])), text, flags=re.DOTALL)


def _plain(text: str) -> str:
    """Return a text with its hidden characters, without blanks round it."""
    text = text.strip(" \t\r\n\0")
    if text.isascii():
        return text
    return re.sub("[\ue000-\ue0ff]", lambda match: chr(ord(match[0]) - _HIDDEN), text)


def _name(text: str) -> str:
    return text or "-"


def check_layout(layout: Layout, path: str = "table") -> None:
    r"""Check that every reader known takes a table of this layout.

    Raises
    ------
    InputError
        A name or text is too long or has a special character, a name comes twice, the first column is not `id`, a type is
        not written, or stands in an array that others do not read (V-104, V-111).

    Examples
    --------
    >>> check_layout(Layout("Rings: all", (Column("id", "I", 1, "P"),)), "rng")
    Traceback (most recent call last):
    vpfx.errors.InputError: rng: description: found 'Rings: all', expected ASCII without ; : , = \ " # (V-104)
    """
    for field in ("description", "narrative"):
        _check_text(getattr(layout, field), field, _LIMITS[field], path)
    if layout.order not in ("<", ">"):
        raise InputError(f"{path}: found byte order {layout.order!r}, expected '<' or '>' (V-101)")
    names = [column.name.lower() for column in layout.columns]
    if names[:1] != ["id"] or len(names) > MOST_COLUMNS:
        raise InputError(f"{path}: found columns {names[:3]} …, expected 1 to {MOST_COLUMNS}, `id` first (V-104)")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{path}: found two columns {twice!r}, expected one of a name (V-104)")
    for column in layout.columns:
        _check_column(column, f"{path}: column {column.name!r}")
    if not 1 <= layout.row_size <= MOST_ROW:
        raise InputError(f"{path}: found rows of {layout.row_size} bytes, expected 1 to {MOST_ROW} (V-103)")


def _check_column(column: Column, where: str) -> None:
    for field, most in _LIMITS.items():
        _check_text(getattr(column, field), field, most, where)
    if not column.name or " " in column.name:
        raise InputError(f"{where}: found that name, expected one without blanks (V-104)")
    if column.kind not in KINDS or column.kind in _NOT_WRITTEN:
        known = " ".join(kind for kind in KINDS if kind not in _NOT_WRITTEN)
        raise InputError(f"{where}: found type {column.kind!r}, expected one of {known} (V-110)")
    if column.key not in _KEYS or len(column.key) != 1:
        raise InputError(f"{where}: found key {column.key!r}, expected P, U or N (V-104)")
    if column.count != COUNTED and not 1 <= column.count <= MOST_COUNT:
        raise InputError(f"{where}: found count {column.count}, expected 1 to {MOST_COUNT} or -1 for * (V-111)")
    if column.count != 1 and column.kind not in _ARRAY_KINDS:
        raise InputError(f"{where}: found several elements of type {column.kind}, expected one (V-111)")


def _check_text(text: str, name: str, most: int, where: str) -> None:
    if not (text.isascii() and text.isprintable()) or _SPECIAL & set(text) or text != text.strip():
        raise InputError(f'{where}: {name}: found {text[:100]!r}, expected ASCII without ; : , = \\ " # (V-104)')
    if len(text) > most:
        raise InputError(f"{where}: {name}: found {len(text)} characters, expected at most {most} (V-104)")


def header_bytes(layout: Layout) -> bytes:
    r"""Return a header, its length first; the first row follows.

    Raises
    ------
    InputError
        As `check_layout`.

    Examples
    --------
    >>> header_bytes(Layout("Rings", (Column("id", "I", 1, "P", "Row id"),)))
    b'"\x00\x00\x00L;Rings;-;id=I,1,P,Row id,-,-,-,:;'
    """
    check_layout(layout)
    columns = "".join(
        f"{c.name}={c.kind},{'*' if c.count == COUNTED else c.count},{c.key},{c.description},"
        f"{c.value_table or '-'},{c.index or '-'},{c.narrative or '-'},:"
        for c in layout.columns
    )
    letter = "M" if layout.order == ">" else "L"
    text = f"{letter};{layout.description};{layout.narrative or '-'};{columns};".encode("ascii")
    return len(text).to_bytes(4, _orders(layout.order)[0], signed=True) + text


def _orders(order: str) -> tuple[_ByteOrder, _ByteOrder]:
    """Return the name of a byte order and of the other one."""
    return ("big", "little") if order == ">" else ("little", "big")


def _broken(path: str, message: str, requirement: str) -> VpfFormatError:
    return VpfFormatError(path, "header", message, requirement)
