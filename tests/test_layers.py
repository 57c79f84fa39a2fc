"""The layering of vpfx, read from its imports: each layer knows only those before it (style: imports point down only)."""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import vpfx
from vpfx.export import EXPORTERS
from vpfx.methods import METHODS

PACKAGE = Path(vpfx.__file__).parent

LAYERS = (
    {"errors"},
    {"registry", "model", "checks"},
    {"exact", "geometry"},
    {"topology"},
    {"dem", "methods", "store", "mesh_files", "vpf"},  # these do not know each other
    {"features", "patches", "measures", "query"},
    {"pipeline", "report", "table_2", "attach", "evpf"},
    {"compare", "plot", "validate", "export"},
    {"gallery"},
    {"cli"},
    {"__main__"},
)
"""Parts of the package, lowest first. Parts of one layer do not import each other."""

MOST_LINES = 400


class Import(NamedTuple):
    """One import of a module of vpfx; `name` is "" where the whole module is imported."""

    module: str
    name: str
    line: int


def modules() -> dict[str, Path]:
    """Return every module by its dotted name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = ["vpfx", *path.relative_to(PACKAGE).with_suffix("").parts]
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def imports(source: str) -> list[Import]:
    """Return all imports from vpfx, those inside functions and under TYPE_CHECKING too."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [Import(alias.name, "", node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            found += [Import(base, alias.name, node.lineno) for alias in node.names]
    return [line for line in found if line.module.split(".")[0] in ("vpfx", "")]


def part_of(module: str) -> str:
    """Return the part of the package a module belongs to: ``vpfx.dem.raster`` belongs to ``dem``."""
    return module.split(".")[1]


def violations(module: str, source: str) -> list[str]:
    """Return what a module may not import."""
    height = {part: i for i, layer in enumerate(LAYERS) for part in layer}
    own = part_of(module)
    wrong = []
    for target, name, line in imports(source):
        where = f"{module}: line {line}: imports {target}{name and ' ' + name}"
        if target.startswith("."):
            wrong.append(f"{where}, expected the full name")
        elif target == "vpfx" and name == "__version__":
            continue  # the root loads nothing, see test_root_loads_nothing
        else:
            part = name if target == "vpfx" else part_of(target)
            if part not in height:
                wrong.append(f"{where} from the root, expected its own module")
            elif part != own and height[part] >= height[own]:
                wrong.append(f"{where}, expected a layer below {own}")
    return wrong


def test_every_part_has_a_layer():
    parts = {part_of(module) for module in MODULES if module != "vpfx"}
    assert parts == set().union(*LAYERS)
    assert sum(map(len, LAYERS)) == len(parts), "a part stands in two layers"


@pytest.mark.parametrize("module", [name for name in MODULES if name != "vpfx"])
def test_imports_point_down(module):
    assert violations(module, MODULES[module].read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "source",
    [
        "from vpfx.cli import main",
        "import vpfx.patches",
        "from vpfx import pipeline",
        "from vpfx import Tin",
        "import vpfx",
        "from . import summary",
        "from ..dem import Dem",
        "from vpfx.methods.base import Patch",
        "def late():\n    from vpfx.pipeline import build",
        "if TYPE_CHECKING:\n    from vpfx.dem import Dem",
    ],
)
def test_a_wrong_import_is_found(source):
    assert len(violations("vpfx.store.rows", source)) == 1


def test_root_loads_nothing():
    """The root names its parts for type checkers and loads each when it is first used, so anyone may ask its version."""
    source = PACKAGE.joinpath("__init__.py").read_text(encoding="utf-8")
    tree = ast.parse(source)
    checking = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    hidden = [line for node in checking for line in imports(ast.unparse(node))]
    assert sorted((line.module, line.name) for line in hidden) == sorted(
        (line.module, line.name) for line in imports(source)
    )
    assert {line.name for line in hidden} == set(vpfx.__all__)
    for line in hidden:
        assert vpfx._HOMES[line.name] == line.module
        assert line.name in import_module(line.module).__all__
    loaded = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    assert {node.module for node in loaded} == {"importlib", "typing"}


def test_nothing_is_imported_by_string():
    """Imports that this file cannot see stand in the root alone."""
    for name, path in MODULES.items():
        called = {
            getattr(node.func, "id", getattr(node.func, "attr", ""))
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Call)
        }
        assert name == "vpfx" or not called & {"import_module", "__import__", "exec", "eval"}, name


@pytest.mark.parametrize("module", MODULES)
def test_public_names_are_listed(module):
    """Every public module lists its public names; a package that holds nothing itself needs no list."""
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    has_content = any(not isinstance(node, ast.Expr) for node in tree.body)
    if not has_content or module.split(".")[-1].startswith("_"):
        return
    lists = [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and [ast.unparse(target) for target in node.targets] == ["__all__"]
    ]
    assert len(lists) == 1, f"{module}: found {len(lists)} lists __all__, expected one"
    names = ast.literal_eval(lists[0])
    assert len(names) == len(set(names))
    assert not [name for name in names if name.startswith("_") or not hasattr(import_module(module), name)]


@pytest.mark.parametrize("module", MODULES)
def test_files_are_short(module):
    n_line = len(MODULES[module].read_text(encoding="utf-8").splitlines())
    assert n_line <= MOST_LINES, f"{module}: found {n_line} lines, expected at most {MOST_LINES}"


def declared(package: str, name: str) -> dict[str, Any]:
    """Return what files of a package declare under a name, by file."""
    found = {}
    for module, path in MODULES.items():
        if not module.startswith(f"vpfx.{package}."):
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            if any(getattr(target, "id", "") == name for target in targets):
                found[module.split(".")[-1]] = getattr(import_module(module), name)
    return found


@pytest.mark.parametrize(
    ("package", "name", "parts"), [("methods", "METHOD", METHODS), ("export", "EXPORTER", EXPORTERS)]
)
def test_parts_stand_in_their_table(package, name, parts):
    found = declared(package, name)
    assert found
    assert {part.name for part in found.values()} == set(parts)
    for file, part in found.items():
        assert parts[part.name] is part
        assert part.name.replace("-", "_") == file, "a part has the name of its file"
