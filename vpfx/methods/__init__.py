"""Ways to turn a patch of posts into a hierarchy: one method a file, all in the table `METHODS`."""

from vpfx.methods import (
    cat,
    constrained_delaunay_pyramid,
    delaunay_pyramid,
    quadtree,
    quaternary,
    restricted_quadtree,
    scarlatos,
    ternary,
    wynne,
)
from vpfx.methods.base import Border, Method, Patch, check_features, checked_options, takes_features
from vpfx.registry import table

__all__ = ["METHODS", "Border", "Method", "Patch", "check_features", "checked_options", "takes_features"]

METHODS = table(
    ternary.METHOD,
    quaternary.METHOD,
    cat.METHOD,
    delaunay_pyramid.METHOD,
    constrained_delaunay_pyramid.METHOD,
    quadtree.METHOD,
    restricted_quadtree.METHOD,
    scarlatos.METHOD,
    wynne.METHOD,
)
