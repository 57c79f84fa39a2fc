"""Attributes for faces: from areas, from rasters of classes, from Python functions, from SQL."""

from vpfx.attach.areas import attach_areas
from vpfx.attach.common import Attached
from vpfx.attach.raster import attach_raster
from vpfx.attach.values import attach_function, attach_sql

__all__ = ["Attached", "attach_areas", "attach_function", "attach_raster", "attach_sql"]
