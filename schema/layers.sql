-- R-210: the GeoPackage layers of one level. {level} is its number, {srs} the CRS id as four little-endian bytes.
-- A geometry is put together from the nodes' own bytes: GeoPackage header (no envelope), WKB header, coordinates.

CREATE VIEW node_{level} AS
SELECT node_id AS OGC_FID,
  CAST(X'47500001{srs}' || X'01E9030000' || xyz AS BLOB) AS geom,
  level AS first_level, tile_id, z
FROM node WHERE level <= {level};

CREATE VIEW edge_{level} AS
SELECT e.edge_id AS OGC_FID,
  CAST(X'47500001{srs}' || X'01EA03000002000000' || s.xyz || t.xyz AS BLOB) AS geom,
  e.level, e.tile_id, e.start_node, e.end_node, e.right_face, e.left_face, e.right_edge, e.left_edge
FROM (
  SELECT first_edge AS low, last_edge AS high FROM tile_level WHERE level = {level}
  UNION ALL SELECT first_border_edge, last_border_edge FROM level WHERE level = {level}
) r
CROSS JOIN edge e ON e.edge_id BETWEEN r.low AND r.high
JOIN node s ON s.node_id = e.start_node JOIN node t ON t.node_id = e.end_node;

CREATE VIEW face_{level} AS
SELECT f.face_id AS OGC_FID,
  CAST(X'47500001{srs}' || X'01EB0300000100000004000000' || a.xyz || b.xyz || c.xyz || a.xyz AS BLOB) AS geom,
  f.level, f.tile_id, p.parent_face AS parent,
  f.slope_centidegrees / 100.0 AS slope, f.aspect_centidegrees / 100.0 AS aspect, f.is_filled
FROM tile_level r
CROSS JOIN face f ON f.face_id BETWEEN r.first_face AND r.last_face
JOIN node a ON a.node_id = f.node_1 JOIN node b ON b.node_id = f.node_2 JOIN node c ON c.node_id = f.node_3
LEFT JOIN parent_child p ON p.child_face = f.face_id
WHERE r.level = {level};
