-- The store of vpfx: the only definition of its tables. Requirements: specs/format.md.
-- x and y are in the units of the CRS, z and errors in metres, ids positive and unique in their table, NULL = none.

CREATE TABLE metadata (                    -- R-110: what was built, from what, how
  name TEXT NOT NULL PRIMARY KEY,          -- such as method, options, crs_wkt2, vertical_datum
  value TEXT NOT NULL                      -- text; JSON where it has parts
);

CREATE TABLE source (                      -- R-111: the files of posts and features
  source_id INTEGER PRIMARY KEY,           -- in order of name
  name TEXT NOT NULL,                      -- file name without folder
  sha256 TEXT NOT NULL,                    -- of the whole file, hexadecimal
  byte_count INTEGER NOT NULL,             -- bytes
  driver TEXT NOT NULL                     -- GDAL driver that read it
);

CREATE TABLE level (                       -- R-120: one complete TIN each
  level INTEGER PRIMARY KEY,               -- 0 is the coarsest
  max_error_bound DOUBLE,                  -- metres: no valid post is off by more; NULL where no bound was asked for
  max_error DOUBLE NOT NULL,               -- metres: greatest vertical error measured at the valid posts
  rmse DOUBLE NOT NULL,                    -- metres: root mean square of the vertical errors
  max_rise DOUBLE,                         -- metres: greatest distance in z of a node new at the level from the level before; NULL on level 0, and where levels are not nested
  post_count INTEGER NOT NULL,             -- valid posts measured
  node_count INTEGER NOT NULL,             -- nodes of the level, those of coarser levels included
  edge_count INTEGER NOT NULL,             -- edges
  face_count INTEGER NOT NULL,             -- faces
  first_border_edge INTEGER,               -- ids of the edges on borders between tiles lie from this ...
  last_border_edge INTEGER,                -- ... to this; NULL if there are none
  border_digest BLOB NOT NULL              -- R-140: BLAKE2b, 16 bytes, over the nodes new at this level and the edges on borders between tiles
);

CREATE TABLE level_cut (                   -- R-122: cuts made on the way to each level
  level INTEGER NOT NULL REFERENCES level(level), -- level
  kind TEXT NOT NULL,                      -- one edge, two edges, three edges, centre, centre and one edge
  cut_count INTEGER NOT NULL,              -- faces cut so
  PRIMARY KEY (level, kind)
);

CREATE TABLE tile (                        -- R-130: the extent, cut
  tile_id INTEGER PRIMARY KEY,             -- 1…n, west to east, then south to north
  tile_name TEXT NOT NULL UNIQUE,          -- r<row>c<column>, from the south-west
  xmin DOUBLE NOT NULL,                    -- CRS units
  ymin DOUBLE NOT NULL,                    -- CRS units
  xmax DOUBLE NOT NULL,                    -- CRS units
  ymax DOUBLE NOT NULL                     -- CRS units
);

CREATE VIRTUAL TABLE tile_index USING rtree( -- R-131: finds tiles by place
  tile_id,                                 -- as in tile
  xmin, xmax, ymin, ymax                   -- CRS units, rounded outwards to single precision
);

CREATE TABLE tile_level (                  -- R-132: where the rows of one tile and level lie, and what they add up to
  tile_level_id INTEGER PRIMARY KEY,       -- (tile_id - 1) * number of levels + level + 1
  tile_id INTEGER NOT NULL REFERENCES tile(tile_id), -- tile
  level INTEGER NOT NULL REFERENCES level(level), -- level
  first_node INTEGER, last_node INTEGER,   -- ids of the nodes that are new at this level and not on a tile border; NULL if none
  first_edge INTEGER, last_edge INTEGER,   -- ids of the edges not on a tile border; NULL if none
  first_face INTEGER, last_face INTEGER,   -- ids of the faces; NULL if none
  digest BLOB NOT NULL                     -- R-140: BLAKE2b, 16 bytes, over the rows of the tile and level
);

CREATE TABLE node (                        -- R-150: corners of faces
  node_id INTEGER PRIMARY KEY,             -- on a tile border or corner by place (R-152), else running
  tile_id INTEGER NOT NULL,                -- tile; on a border the one of least id
  level INTEGER NOT NULL,                  -- level at which the node first appears; it belongs to every finer one
  x DOUBLE NOT NULL,                       -- CRS units
  y DOUBLE NOT NULL,                       -- CRS units
  z DOUBLE NOT NULL,                       -- metres
  z_parent DOUBLE,                         -- metres: surface of the level before the node's first at its place; NULL on level 0, and where levels are not nested
  xyz BLOB NOT NULL                        -- the same as three little-endian doubles (VPF type Y), for the layers
);

CREATE TABLE edge (                        -- R-160: winged edges of every level
  edge_id INTEGER PRIMARY KEY,             -- on a tile border by place (R-152), else running
  tile_id INTEGER NOT NULL,                -- tile; on a border the one of least id
  level INTEGER NOT NULL,                  -- level
  start_node INTEGER NOT NULL,             -- node
  end_node INTEGER NOT NULL,               -- node
  right_face INTEGER,                      -- face to the right from start to end; NULL: outside
  left_face INTEGER,                       -- face to the left; NULL: outside
  right_edge INTEGER NOT NULL,             -- next edge counter-clockwise round the end node
  left_edge INTEGER NOT NULL               -- next edge counter-clockwise round the start node
);

CREATE TABLE face (                        -- R-170: triangles of every level
  face_id INTEGER PRIMARY KEY,             -- running by tile, then level, then parent
  tile_id INTEGER NOT NULL,                -- tile
  level INTEGER NOT NULL,                  -- level
  node_1 INTEGER NOT NULL,                 -- corners, counter-clockwise seen from above
  node_2 INTEGER NOT NULL,                 -- node
  node_3 INTEGER NOT NULL,                 -- node
  edge_1 INTEGER NOT NULL,                 -- joins node_1 and node_2
  edge_2 INTEGER NOT NULL,                 -- joins node_2 and node_3
  edge_3 INTEGER NOT NULL,                 -- joins node_3 and node_1
  is_filled INTEGER NOT NULL,              -- 1: on ground without data, heights interpolated (built with fill)
  slope_centidegrees INTEGER NOT NULL,     -- steepness, hundredths of a degree, 0 is level ground
  aspect_centidegrees INTEGER              -- direction of steepest descent, hundredths of a degree clockwise from grid north; NULL: level
);

CREATE TABLE t_junction (                  -- R-190: nodes inside edges; none where the method keeps faces adjacent
  edge_id INTEGER NOT NULL,                -- edge of one face
  node_id INTEGER NOT NULL,                -- node inside it, of the same level
  tile_id INTEGER NOT NULL,                -- tile
  level INTEGER NOT NULL,                  -- level
  gap DOUBLE NOT NULL,                     -- metres: height of the node less that of the edge there
  PRIMARY KEY (edge_id, node_id)
) WITHOUT ROWID;

CREATE TABLE parent_child (                -- R-180: links between a level and the next finer one
  child_face INTEGER NOT NULL,             -- face of level k + 1
  parent_face INTEGER NOT NULL,            -- face of level k that shares area with it
  PRIMARY KEY (child_face, parent_face)
) WITHOUT ROWID;

CREATE TABLE shared_area (                 -- R-182: how much area linked faces share; no rows where levels are nested
  child_face INTEGER NOT NULL,             -- face of level k + 1
  parent_face INTEGER NOT NULL,            -- face of level k
  area DOUBLE NOT NULL,                    -- squared CRS units
  PRIMARY KEY (child_face, parent_face)
) WITHOUT ROWID;

CREATE INDEX parent_child_by_parent ON parent_child (parent_face, child_face);

CREATE TABLE face_layer (                  -- R-211: always empty; gives the columns of the layers face_K their types
  OGC_FID INTEGER,                         -- face
  geom POLYGON,                            -- GeoPackage geometry, with z
  face_id INTEGER,                         -- face
  level INTEGER,                           -- level
  tile_id INTEGER,                         -- tile
  parent INTEGER,                          -- face of the coarser level that shares area with it; NULL on level 0
  slope DOUBLE,                            -- degrees, 0 is level ground
  aspect DOUBLE,                           -- degrees clockwise from grid north, of steepest descent; NULL: level ground
  is_filled INTEGER                        -- 1: on ground without data
);

CREATE TABLE feature_class (               -- R-220: kinds of things faces can be part of, such as soil; each has a table of its name
  class_id INTEGER PRIMARY KEY,            -- running
  class_name TEXT NOT NULL UNIQUE,         -- name of its table (R-225)
  description TEXT NOT NULL                -- for people; may be empty
);

CREATE TABLE feature_column (              -- R-221: columns of those tables
  class_id INTEGER NOT NULL REFERENCES feature_class(class_id) ON DELETE CASCADE, -- class
  column_name TEXT NOT NULL,               -- column of its table
  kind TEXT NOT NULL CHECK (kind IN ('text', 'integer', 'real', 'date')), -- of its values
  unit TEXT NOT NULL,                      -- of its values, such as m; empty if none
  description TEXT NOT NULL,               -- for people; may be empty
  PRIMARY KEY (class_id, column_name)
) WITHOUT ROWID;

CREATE TABLE value_description (           -- R-222: what codes mean (VPF's value description tables)
  class_id INTEGER NOT NULL,               -- class
  column_name TEXT NOT NULL,               -- column of its table
  value TEXT NOT NULL,                     -- a value of it, as text
  description TEXT NOT NULL,               -- what it means
  PRIMARY KEY (class_id, column_name, value),
  CONSTRAINT fk_value_column FOREIGN KEY (class_id, column_name) REFERENCES feature_column (class_id, column_name) ON DELETE CASCADE
) WITHOUT ROWID;

CREATE TABLE feature (                     -- R-223: things of all classes
  feature_id INTEGER PRIMARY KEY,          -- running; the key of its row in the table of the class
  class_id INTEGER NOT NULL REFERENCES feature_class(class_id) ON DELETE CASCADE, -- class
  CONSTRAINT uk_feature_class UNIQUE (class_id, feature_id)
);

CREATE TABLE face_feature (                -- R-224: the features of faces of any level; they hold for all faces below until others do
  face_id INTEGER NOT NULL REFERENCES face(face_id), -- face
  class_id INTEGER NOT NULL,               -- class of the feature
  feature_id INTEGER NOT NULL,             -- feature
  share DOUBLE NOT NULL CHECK (share > 0 AND share <= 1), -- part of the area of the face; those of a face and class add up to 1 at most
  PRIMARY KEY (face_id, class_id, feature_id),
  CONSTRAINT fk_face_feature FOREIGN KEY (class_id, feature_id) REFERENCES feature (class_id, feature_id) ON DELETE CASCADE
) WITHOUT ROWID;

CREATE INDEX face_feature_by_feature ON face_feature (class_id, feature_id, face_id);
