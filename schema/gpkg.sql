-- The tables every GeoPackage must have (OGC 12-128r19, version 1.4, annex C), as SQLite DDL.

CREATE TABLE gpkg_spatial_ref_sys (
  srs_name TEXT NOT NULL,                  -- name for people
  srs_id INTEGER PRIMARY KEY,              -- key in this file
  organization TEXT NOT NULL,              -- who defined it, such as EPSG
  organization_coordsys_id INTEGER NOT NULL, -- its number there
  definition TEXT NOT NULL,                -- WKT 1
  description TEXT                         -- free text
);

CREATE TABLE gpkg_contents (
  table_name TEXT NOT NULL PRIMARY KEY,    -- table or view
  data_type TEXT NOT NULL,                 -- features or attributes
  identifier TEXT UNIQUE,                  -- name for people
  description TEXT DEFAULT '',             -- free text
  last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')), -- fixed by vpfx, so that a rebuild is byte-identical
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, -- bounding box, CRS units
  srs_id INTEGER,                          -- CRS of the layer
  CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id)
);

CREATE TABLE gpkg_geometry_columns (
  table_name TEXT NOT NULL,                -- layer
  column_name TEXT NOT NULL,               -- its geometry column
  geometry_type_name TEXT NOT NULL,        -- POINT, LINESTRING or POLYGON
  srs_id INTEGER NOT NULL,                 -- CRS of the layer
  z TINYINT NOT NULL,                      -- 1: every geometry has z
  m TINYINT NOT NULL,                      -- 0: none has m
  CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
  CONSTRAINT uk_gc_table_name UNIQUE (table_name),
  CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
  CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys (srs_id)
);

CREATE TABLE gpkg_extensions (
  table_name TEXT,                         -- table concerned, NULL for the whole file
  column_name TEXT,                        -- column concerned
  extension_name TEXT NOT NULL,            -- author_name
  definition TEXT NOT NULL,                -- where it is described
  scope TEXT NOT NULL,                     -- read-write or write-only
  CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name)
);
