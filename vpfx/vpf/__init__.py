"""Vector Product Format (MIL-STD-2407): tables, directories and features, without any store (specs/vpf.md).

::

    one table        table (read), writer ◄─ given_columns (checked)
                       └─ header, index_file, rows ─ kernels, values
    beside it        spatial_index ─ bins, thematic_index
    the standard's   layouts: columns of its tables
    directories      catalog: Database > Library > Coverage > FeatureClass ─ schema, paths; opening: any directory
    features         reader: a class ─ geometry ─ rings; merge; fields
    for others       layers (as vector layers), gpkg (as a GeoPackage), listing (to print)
"""
