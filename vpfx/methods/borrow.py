"""Arrays without a reference count, for kernels that call others millions of times.

numba counts the references to an array at every call that takes it; where the calls are short, the atomic counting takes
most of the time. A borrowed array is not counted: whoever borrows it keeps the original alive.
"""

from __future__ import annotations

from typing import Any

from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

__all__ = ["borrowed"]


@intrinsic
def borrowed(_typing_context: Any, array: Any) -> tuple[Any, Any]:
    """Return the same array without a reference count; the original must outlive it."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        value = make_array(signature.args[0])(context, builder, args[0])
        value.meminfo = cgutils.get_null_value(value.meminfo.type)
        return value._getvalue()

    return array(array), generate
