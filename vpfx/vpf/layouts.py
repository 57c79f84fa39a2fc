"""The tables of VPF that are written, as data: columns in their order, with the widths to write (specs/vpf.md, V-250 to V-256).

The first line is the description; each other line is a column: name, type, elements, key, description. Tables whose
columns hang on the coverage are functions: what is the type of coordinates, are there tiles.
"""

from __future__ import annotations

from collections.abc import Sequence

from vpfx.errors import InputError
from vpfx.vpf.header import COUNTED, Column, Layout

__all__ = [
    "CAT", "COORDINATES", "DHT", "DQT", "EBR", "FAC", "FBR", "FCS", "GRT", "INT_VDT", "LAT", "LHT",
    "PRIMITIVES", "RNG", "TILEREF", "char_vdt", "cnd", "edg", "fca", "feature", "fit", "join",
]  # fmt: skip

COORDINATES = "CZBY"
"""Types of coordinates: x and y, with z, in single and in double precision."""

PRIMITIVES = {"edg": "L", "fac": "A", "end": "P", "cnd": "P", "txt": "T"}
"""Tables of primitives, and the type of the feature classes on them."""

_TILE = "tile_id S 1 N Tile as row of tileref.aft"


def _columns(text: str) -> tuple[Column, ...]:
    """Columns of lines: name, type, elements (``*`` for any number), key, description."""
    columns = []
    for line in filter(str.strip, text.splitlines()):
        name, kind, count, key, description = line.split(None, 4)
        columns.append(Column(name, kind, COUNTED if count == "*" else int(count), key, description))
    return tuple(columns)


def _table(text: str) -> Layout:
    """Layout of lines: its description, then its columns."""
    description, columns = text.strip().split("\n", 1)
    return Layout(description, _columns(columns))


DHT = _table("""
    Database Header Table
        id              I 1   P Row id
        vpf_version     T 10  N Version of VPF
        database_name   T 8   N Directory name of the database
        database_desc   T 100 N Description of the database
        media_standard  T 20  N Media standard
        originator      T 50  N Producer of the database
        addressee       T 100 N Address of the producer
        media_volumes   T 1   N Number of media volumes
        seq_numbers     T 1   N Sequence numbers of media volumes
        num_data_sets   T 1   N Number of libraries
        security_class  T 1   N Security classification
        downgrading     T 3   N Downgrading
        downgrade_date  D 1   N Date of downgrading
        releasability   T 20  N Restrictions of release
        other_std_name  T 50  N Name of other standard
        other_std_date  D 1   N Date of other standard
        other_std_ver   T 10  N Version of other standard
        transmittal_id  T 1   N Transmittal id
        edition_number  T 10  N Edition number of the database
        edition_date    D 1   N Date of the edition
""")

LAT = _table("""
    Library Attribute Table
        id           I 1 P Row id
        library_name T 8 N Name of the library
        xmin         F 1 N Westernmost coordinate
        ymin         F 1 N Southernmost coordinate
        xmax         F 1 N Easternmost coordinate
        ymax         F 1 N Northernmost coordinate
""")

LHT = _table("""
    Library Header Table
        id               I 1   P Row id
        product_type     T 12  N Product type
        library_name     T 12  N Name of the library
        description      T 100 N Description of the library
        data_struct_code T 1   N Data structure code
        scale            I 1   N Denominator of the scale
        source_series    T 15  N Series of the source
        source_id        T 30  N Id of the source
        source_edition   T 20  N Edition of the source
        source_name      T 100 N Name of the source
        source_date      D 1   N Date of the source
        security_class   T 1   N Security classification
        downgrading      T 3   N Downgrading
        downgrading_date D 1   N Date of downgrading
        releasability    T 20  N Restrictions of release
""")

GRT = _table("""
    Geographic Reference Table
        id               I 1  P Row id
        data_type        T 3  N Data type
        units            T 3  N Units of measure
        ellipsoid_name   T 15 N Ellipsoid
        ellipsoid_detail T 50 N Axes of the ellipsoid
        vert_datum_name  T 15 N Vertical datum
        vert_datum_code  T 3  N Code of the vertical datum
        sound_datum_name T 15 N Sounding datum
        sound_datum_code T 3  N Code of the sounding datum
        geo_datum_name   T 15 N Geodetic datum
        geo_datum_code   T 3  N Code of the geodetic datum
        projection_name  T 20 N Projection
""")

CAT = _table("""
    Coverage Attribute Table
        id            I 1  P Row id
        coverage_name T 8  N Name of the coverage
        description   T 50 N Description of the coverage
        level         I 1  N Topology level
""")

DQT = _table("""
    Data Quality Table
        id               I 1  P Row id
        vpf_level        T 8  N VPF level
        vpf_level_name   T 20 N Name of the VPF level
        feature_complete T *  N Completeness of features
        attrib_complete  T *  N Completeness of attributes
        logical_consist  T *  N Logical consistency
        edition_num      T 8  N Edition number
        creation_date    D 1  N Date of creation
        revision_date    D 1  N Date of revision
        spec_name        T 20 N Name of the product specification
        spec_date        D 1  N Date of the product specification
        earliest_source  D 1  N Date of the earliest source
        latest_source    D 1  N Date of the latest source
        quant_att_acc    T *  N Accuracy of quantitative attributes
        qual_att_acc     T *  N Accuracy of qualitative attributes
        collection_spec  T *  N Name of the collection specification
        source_file_name T 12 N Name of the source file
        abs_horiz_acc    T *  N Absolute horizontal accuracy
        abs_horiz_units  T 20 N Units of absolute horizontal accuracy
        abs_vert_acc     T *  N Absolute vertical accuracy
        abs_vert_units   T 20 N Units of absolute vertical accuracy
        rel_horiz_acc    T *  N Horizontal accuracy from point to point
        rel_horiz_units  T 20 N Units of horizontal accuracy from point to point
        rel_vert_acc     T *  N Vertical accuracy from point to point
        rel_vert_units   T 20 N Units of vertical accuracy from point to point
        comments         T *  N Comments
""")

FCS = _table("""
    Feature Class Schema Table
        id            I 1  P Row id
        feature_class T 8  N Name of the feature class
        table1        T 12 N First table
        table1_key    T 16 N Column in the first table
        table2        T 12 N Second table
        table2_key    T 16 N Column in the second table
""")

FAC = _table("""
    Face Primitive Table
        id       I 1 P Row id
        ring_ptr I 1 N First ring of the face
""")

RNG = _table("""
    Ring Table
        id         I 1 P Row id
        face_id    I 1 N Face
        start_edge I 1 N First edge of the ring
""")

_RECTANGLE = """
    id   I 1 P Row id
    xmin F 1 N Least x
    ymin F 1 N Least y
    xmax F 1 N Greatest x
    ymax F 1 N Greatest y
"""

EBR = _table(f"Edge Bounding Rectangle Table{_RECTANGLE}")

FBR = _table(f"Face Bounding Rectangle Table{_RECTANGLE}")

INT_VDT = _table("""
    Integer Value Description Table
        id          I 1  P Row id
        table       T 12 N Feature table
        attribute   T 16 N Column in the feature table
        value       I 1  N Value
        description T 50 N Description of the value
""")

TILEREF = _table("""
    Tile Reference Area Feature Table
        id        I 1 P Row id
        tile_name T * N Path of the tile
        fac_id    I 1 N Face of the tile
""")


def char_vdt(width: int, kind: str = "T") -> Layout:
    """``char.vdt``: descriptions of coded texts; `width` is that of the widest value, `kind` T or L.

    Examples
    --------
    >>> char_vdt(5).columns[3].count
    5
    """
    columns = list(INT_VDT.columns)
    columns[3] = columns[3]._replace(kind=kind, count=width)
    columns[4] = columns[4]._replace(kind=kind)
    return Layout("Character Value Description Table", tuple(columns))


def fca(width: int | None = None) -> Layout:
    """``fca``: feature classes described; without a width, descriptions are as long as each is.

    Examples
    --------
    >>> fca(40).is_variable, fca().is_variable
    (False, True)
    """
    return _table(f"""
    Feature Class Attribute Table
        id     I 1  P Row id
        fclass T 8  U Name of the feature class
        type   T 1  N Type of the feature class
        descr  T {"*" if width is None else width} N Description of the feature class
    """)


def cnd(coordinate: str, *, is_tiled: bool) -> Layout:
    """``cnd``: connected nodes; in tiles the first edge is a triplet.

    Raises
    ------
    InputError
        The type of coordinates is none of `COORDINATES`.

    Examples
    --------
    >>> cnd("Z", is_tiled=True).columns[1].kind
    'K'
    """
    return _table(f"""
    Connected Node Primitive Table
        id         I 1 P Row id
        first_edge {"K" if is_tiled else "I"} 1 N First edge of the node
        coordinate {_coordinate(coordinate)} 1 N Coordinates of the node
    """)


def edg(coordinate: str) -> Layout:
    """``edg``: edges of topology level 3. Links are triplets in tiles or not.

    Raises
    ------
    InputError
        The type of coordinates is none of `COORDINATES`.

    Examples
    --------
    >>> edg("C").columns[-1].count
    -1
    """
    return _table(f"""
    Edge Primitive Table
        id          I 1 P Row id
        start_node  I 1 N Start node
        end_node    I 1 N End node
        right_face  K 1 N Right face
        left_face   K 1 N Left face
        right_edge  K 1 N Next edge from the end node
        left_edge   K 1 N Next edge from the start node
        coordinates {_coordinate(coordinate)} * N Coordinates of the edge
    """)


def fit(*, is_tiled: bool) -> Layout:
    """``edg.fit`` and the like: features of each primitive.

    Examples
    --------
    >>> [column.name for column in fit(is_tiled=True).columns]
    ['id', 'prim_id', 'tile_id', 'fc_id', 'feature_id']
    """
    return _table(f"""
    Feature Index Table
        id         I 1 P Row id
        prim_id    I 1 N Primitive
        {_TILE if is_tiled else ""}
        fc_id      I 1 N Feature class as row of fca
        feature_id I 1 N Feature as row of its table
    """)


def feature(description: str, attributes: Sequence[Column], primitive: str, *, is_tiled: bool) -> Layout:
    """A feature table: id, attributes, tile, primitive; without a primitive the features have a join table (`join`).

    Examples
    --------
    >>> attributes = [Column("f_code", "T", 5, "N", "Feature code", "char.vdt", "f_code.lti")]
    >>> [column.name for column in feature("Shores", attributes, "edg", is_tiled=True).columns]
    ['id', 'f_code', 'tile_id', 'edg_id']
    """
    first = Column("id", "I", 1, "P", "Row id")
    return Layout(description, (first, *attributes, *_tail(primitive, is_tiled)))


def join(description: str, key: str, primitive: str, *, is_tiled: bool) -> Layout:
    """A join table: which primitives each feature has; `key` is the column that names the feature.

    Examples
    --------
    >>> [column.name for column in join("Shores and edges", "shorel_id", "edg", is_tiled=True).columns]
    ['id', 'shorel_id', 'tile_id', 'edg_id']
    """
    first = Column("id", "I", 1, "P", "Row id"), Column(key, "I", 1, "N", "Feature")
    return Layout(description, (*first, *_tail(primitive, is_tiled)))


def _tail(primitive: str, is_tiled: bool) -> tuple[Column, ...]:
    """Columns that name a primitive."""
    if not primitive:
        return ()
    if primitive not in PRIMITIVES:
        raise InputError(f"found the primitive {primitive!r}, expected one of: {', '.join(PRIMITIVES)}")
    return _columns(f"{_TILE if is_tiled else ''}\n{primitive}_id I 1 N Primitive as row of {primitive}")


def _coordinate(kind: str) -> str:
    if kind not in COORDINATES or len(kind) != 1:
        raise InputError(f"found coordinates of type {kind!r}, expected one of: {', '.join(COORDINATES)}")
    return kind
