"""Directories of a VPF database under way: names in one case, tables by their names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vpfx.errors import StoreError
from vpfx.vpf.table import Layout, TableWriter, write_table

__all__ = ["Folder"]


class Folder:
    """A directory that is written.

    Parameters
    ----------
    path : Path
        It exists.
    is_upper : bool
        Whether names are written in upper case, else lower.

    Raises
    ------
    StoreError
        The medium refuses; so do all methods that write.

    Examples
    --------
    >>> Folder(Path(), is_upper=True).named("tinface.aft")
    'TINFACE.AFT'
    """

    def __init__(self, path: Path, *, is_upper: bool) -> None:
        self.path, self.is_upper = path, is_upper

    def named(self, name: str) -> str:
        """Return the name of a file, directory or class as it is written, in tables too."""
        return name.upper() if self.is_upper else name.lower()

    def folder(self, *parts: str) -> Folder:
        """Make a directory in this one, and those that lead to it."""
        path = self.path.joinpath(*map(self.named, parts))
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{path}: cannot be made: {error.strerror}") from error
        return Folder(path, is_upper=self.is_upper)

    def write(self, name: str, layout: Layout, columns: Mapping[str, Any]) -> None:
        """Write a table."""
        write_table(self.path / self.named(name), self._cased(layout), columns)

    def open(self, name: str, layout: Layout) -> TableWriter:
        """Open a table that is written in parts."""
        return TableWriter(self.path / self.named(name), self._cased(layout))

    def write_bytes(self, name: str, data: bytes) -> None:
        """Write an index."""
        path = self.path / self.named(name)
        try:
            path.write_bytes(data)
        except OSError as error:
            raise StoreError(f"{path}: cannot be written: {error.strerror}") from error

    def _cased(self, layout: Layout) -> Layout:
        """Return a layout that names tables as they are written."""
        columns = (
            column._replace(value_table=self.named(column.value_table), index=self.named(column.index))
            for column in layout.columns
        )
        return layout._replace(columns=tuple(columns))
