-- R-230 to R-234: views for questions in SQL, in every store. They use no function that SQLite holds for unsafe in a view.
-- CROSS JOIN and LEFT JOIN keep SQLite from another order of the loops. A view that follows links holds its recursion in the
-- argument of json_each, which may name the face of the row: so only links of the faces asked for are followed.

-- R-230: faces across the three edges of a face; neighbour is NULL outside, and where the face across has a T-junction in its edge.
CREATE VIEW face_neighbour AS
SELECT f.face_id, 1 AS side, e.edge_id, CASE e.left_face WHEN f.face_id THEN e.right_face ELSE e.left_face END AS neighbour
FROM face f CROSS JOIN edge e ON e.edge_id = f.edge_1
UNION ALL
SELECT f.face_id, 2, e.edge_id, CASE e.left_face WHEN f.face_id THEN e.right_face ELSE e.left_face END
FROM face f CROSS JOIN edge e ON e.edge_id = f.edge_2
UNION ALL
SELECT f.face_id, 3, e.edge_id, CASE e.left_face WHEN f.face_id THEN e.right_face ELSE e.left_face END
FROM face f CROSS JOIN edge e ON e.edge_id = f.edge_3;

-- R-231: plan area of a face, squared CRS units.
CREATE VIEW face_area AS
SELECT f.face_id, f.level, ((b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y)) / 2 AS area
FROM face f
LEFT JOIN node a ON a.node_id = f.node_1
LEFT JOIN node b ON b.node_id = f.node_2
LEFT JOIN node c ON c.node_id = f.node_3;

-- R-232: faces by level and tile, with their bounding boxes, CRS units: give a level, and tiles found in tile_index.
CREATE VIEW region AS
SELECT f.face_id, l.level, t.tile_id,
  min(a.x, b.x, c.x) AS xmin, min(a.y, b.y, c.y) AS ymin, max(a.x, b.x, c.x) AS xmax, max(a.y, b.y, c.y) AS ymax
FROM tile t
CROSS JOIN level l
CROSS JOIN tile_level r ON r.tile_level_id = (t.tile_id - 1) * (SELECT count(*) FROM level) + l.level + 1
CROSS JOIN face f ON f.face_id BETWEEN r.first_face AND r.last_face
LEFT JOIN node a ON a.node_id = f.node_1
LEFT JOIN node b ON b.node_id = f.node_2
LEFT JOIN node c ON c.node_id = f.node_3;

-- R-233: faces of all coarser levels a face comes from, and which part of its area it shares with each.
CREATE VIEW face_ancestor AS
SELECT f.face_id, g.face_id AS ancestor, g.level, j.value AS share
FROM face f
CROSS JOIN json_each((
  WITH RECURSIVE up (face_id, level, share) AS (
    SELECT f.face_id, f.level, 1.0
    UNION ALL
    SELECT p.parent_face, u.level - 1, u.share
      * CASE WHEN s.area IS NULL THEN 1.0 ELSE s.area / (SELECT area FROM face_area WHERE face_id = u.face_id) END
    FROM up u
    CROSS JOIN parent_child p ON p.child_face = u.face_id
    LEFT JOIN shared_area s ON s.child_face = p.child_face AND s.parent_face = p.parent_face
    WHERE u.level > 0
  )
  SELECT '{' || group_concat('"' || face_id || '":' || printf('%!.17g', share)) || '}'
  FROM (SELECT face_id, sum(share) AS share FROM up WHERE face_id <> f.face_id GROUP BY face_id)
)) j
CROSS JOIN face g ON g.face_id = CAST(j.key AS INTEGER);

-- R-233: faces of all finer levels that come from a face, and which part of its area each shares with it.
CREATE VIEW face_descendant AS
SELECT f.face_id, g.face_id AS descendant, g.level, j.value AS share
FROM face f
CROSS JOIN json_each((
  WITH RECURSIVE down (face_id, level, area, share) AS (
    SELECT face_id, level, area, 1.0 FROM face_area WHERE face_id = f.face_id
    UNION ALL
    SELECT k.face_id, k.level, k.area, d.share * coalesce(s.area, k.area) / d.area
    FROM down d
    CROSS JOIN parent_child p ON p.parent_face = d.face_id
    CROSS JOIN face_area k ON k.face_id = p.child_face AND k.level = d.level + 1
    LEFT JOIN shared_area s ON s.child_face = p.child_face AND s.parent_face = p.parent_face
  )
  SELECT '{' || group_concat('"' || face_id || '":' || printf('%!.17g', share)) || '}'
  FROM (SELECT face_id, sum(share) AS share FROM down WHERE face_id <> f.face_id GROUP BY face_id)
)) j
CROSS JOIN face g ON g.face_id = CAST(j.key AS INTEGER);

-- R-234: the features of a face of any level, by inheritance, and the parts of its area they have.
-- up: the face, and its ancestors as far as the first with features of its own, each with its part of the face.
-- down: the faces below, each with its part and its owner: the nearest face above, below the one asked, with features; else NULL.
CREATE VIEW face_attribute AS
SELECT f.face_id, f.level, c.class_name, CAST(j.key AS INTEGER) AS feature_id, j.value AS share
FROM face f
CROSS JOIN feature_class c
CROSS JOIN json_each((
  WITH RECURSIVE up (face_id, level, share) AS (
    SELECT f.face_id, f.level, 1.0
    UNION ALL
    SELECT p.parent_face, u.level - 1, u.share
      * CASE WHEN s.area IS NULL THEN 1.0 ELSE s.area / (SELECT area FROM face_area WHERE face_id = u.face_id) END
    FROM up u
    CROSS JOIN parent_child p ON p.child_face = u.face_id
    LEFT JOIN shared_area s ON s.child_face = p.child_face AND s.parent_face = p.parent_face
    WHERE u.level > 0 AND NOT EXISTS (SELECT 1 FROM face_feature w WHERE w.face_id = u.face_id AND w.class_id = c.class_id)
  ),
  down (face_id, level, area, share, owner) AS (
    SELECT face_id, level, area, 1.0, NULL FROM face_area WHERE face_id = f.face_id
    UNION ALL
    SELECT k.face_id, k.level, k.area, d.share * coalesce(s.area, k.area) / d.area, coalesce(
      (SELECT w.face_id FROM face_feature w WHERE w.face_id = k.face_id AND w.class_id = c.class_id LIMIT 1), d.owner)
    FROM down d
    CROSS JOIN parent_child p ON p.parent_face = d.face_id
    CROSS JOIN face_area k ON k.face_id = p.child_face AND k.level = d.level + 1
    LEFT JOIN shared_area s ON s.child_face = p.child_face AND s.parent_face = p.parent_face
  ),
  owned (owner, share, total) AS (
    SELECT owner, sum(share), sum(sum(share)) OVER () FROM down
    WHERE level = (SELECT max(level) FROM level) GROUP BY owner
  )
  SELECT '{' || group_concat('"' || feature_id || '":' || printf('%!.17g', share)) || '}'
  FROM (
    SELECT w.feature_id, sum(o.share * u.share * w.share / o.total) AS share
    FROM owned o
    CROSS JOIN up u ON o.owner IS NULL OR u.face_id = f.face_id
    CROSS JOIN face_feature w ON w.face_id = coalesce(o.owner, u.face_id) AND w.class_id = c.class_id
    GROUP BY w.feature_id
  )
)) j;
