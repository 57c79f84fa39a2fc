"""The store: hierarchies as rows of one SQLite file that is also a GeoPackage."""
