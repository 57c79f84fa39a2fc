"""Checks of numbers that callers pass, in one place."""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np

from vpfx.errors import InputError

__all__ = ["number", "whole_number", "whole_numbers"]


def whole_number(value: Any, name: str, least: float = -math.inf, most: float = math.inf) -> int:
    """Return a whole number of any integer type as an int.

    Parameters
    ----------
    value : int, NumPy integer or what else can be an index; no bool
        What was passed.
    name : str
        What it is, for the message.
    least, most : int, optional
        The range, both ends included.

    Raises
    ------
    InputError
        It is of another type, or outside the range.

    Examples
    --------
    >>> whole_number(np.int16(3), "workers", 1)
    3
    >>> whole_number(2.5, "workers", 1)
    Traceback (most recent call last):
    vpfx.errors.InputError: workers: found 2.5, expected a whole number
    >>> whole_number(np.int16(0), "workers", 1)
    Traceback (most recent call last):
    vpfx.errors.InputError: workers: found 0, expected at least 1
    """
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError
        number = operator.index(value)
    except TypeError:
        raise InputError(f"{name}: found {_in_one_line(value)}, expected a whole number") from None
    if not least <= number <= most:
        wanted = f"at least {least}" if most == math.inf else f"{least} … {most}"
        raise InputError(f"{name}: found {number}, expected {wanted}")
    return number


def whole_numbers(values: Any, name: str, least: float = -math.inf) -> list[int]:
    """Return a sequence of whole numbers as a list, each checked like a `whole_number`.

    Examples
    --------
    >>> whole_numbers(np.array([9, 12]), "grid", 1)
    [9, 12]
    """
    try:
        given = list(values)
    except TypeError:
        raise InputError(f"{name}: found {_in_one_line(values)}, expected several whole numbers") from None
    return [whole_number(value, name, least) for value in given]


def number(value: Any, name: str, least: float, limit: float = math.inf) -> float:
    """Return a number of any real type as a float.

    Parameters
    ----------
    value : float, int or what else is a number; no bool, no text
        What was passed.
    name : str
        What it is, for the message.
    least, limit : float
        The least value allowed, and the least that is too great.

    Raises
    ------
    InputError
        It is of another type, outside the range, or NaN.

    Examples
    --------
    >>> number(np.float32(0.5), "tolerance", 0)
    0.5
    >>> number(0.5, "xy_ratio", 0, 0.5)
    Traceback (most recent call last):
    vpfx.errors.InputError: xy_ratio: found 0.5, expected a number from 0 to below 0.5
    """
    try:
        found = math.nan if isinstance(value, bool | np.bool_ | str | bytes) else float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not least <= found < limit:
        wanted = f"from {least}" if limit == math.inf else f"from {least} to below {limit}"
        raise InputError(f"{name}: found {_in_one_line(value)}, expected a number {wanted}")
    return found


def _in_one_line(value: Any) -> str:
    return " ".join(repr(value).split())
