-- R-210: the GeoPackage layers of one level. {level} is its number, {srs} the CRS id as four little-endian bytes.
-- A geometry is put together from the nodes' own bytes: GeoPackage header (no envelope), WKB header, coordinates.
-- CROSS JOIN keeps SQLite from another order of the loops: tile by tile, rows by range of ids.

CREATE VIEW node_{level} AS
SELECT node_id AS OGC_FID,
  CAST(X'47500001{srs}' || X'01E9030000' || xyz AS BLOB) AS geom,
  node_id, level AS first_level, tile_id, z, z_parent
FROM node WHERE level <= {level};

CREATE VIEW edge_{level} AS
SELECT e.edge_id AS OGC_FID,
  CAST(X'47500001{srs}' || X'01EA03000002000000'
    || (SELECT xyz FROM node WHERE node_id = e.start_node)
    || (SELECT xyz FROM node WHERE node_id = e.end_node) AS BLOB) AS geom,
  e.edge_id, e.level, e.tile_id, e.start_node, e.end_node, e.right_face, e.left_face, e.right_edge, e.left_edge
FROM (
  SELECT first_edge AS low, last_edge AS high FROM tile_level WHERE level = {level}
  UNION ALL SELECT first_border_edge, last_border_edge FROM level WHERE level = {level}
) r
CROSS JOIN edge e ON e.edge_id BETWEEN r.low AND r.high;

CREATE VIEW face_{level} AS
SELECT * FROM face_layer
UNION ALL
SELECT f.face_id AS OGC_FID,
  CAST(X'47500001{srs}' || X'01EB0300000100000004000000'
    || (SELECT xyz FROM node WHERE node_id = f.node_1)
    || (SELECT xyz FROM node WHERE node_id = f.node_2)
    || (SELECT xyz FROM node WHERE node_id = f.node_3)
    || (SELECT xyz FROM node WHERE node_id = f.node_1) AS BLOB) AS geom,
  f.face_id, f.level, f.tile_id,
  (SELECT parent_face FROM parent_child WHERE child_face = f.face_id) AS parent,
  f.slope_centidegrees / 100.0 AS slope, f.aspect_centidegrees / 100.0 AS aspect, f.is_filled
FROM tile_level r
CROSS JOIN face f ON f.face_id BETWEEN r.first_face AND r.last_face
WHERE r.level = {level};
