"""What callers pass as numbers, as NumPy has them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError, shortened


def as_array(value: Any, name: str, dtype: type | None = np.float64) -> NDArray[Any]:
    """Return numbers as an array in the byte order of this machine, tensors without their graph.

    Args:
        value: An array, a tensor, a number, or lists of them.
        name: What an error calls it.
        dtype: Of the result; None: that of `value`.

    Raises:
        OmnistereoError: If it holds something else than real numbers, if NumPy has no such arrays,
            as of bfloat16 or sparse tensors, or if values are masked: most functions of NumPy
            would use what is below the mask.
    """
    try:
        array = np.asarray(value.detach().cpu() if hasattr(value, "detach") else value)
    except (TypeError, ValueError, RuntimeError) as error:
        kind = f"{type(value).__name__} of {getattr(value, 'dtype', 'something')}"
        raise OmnistereoError(
            f"{name} is a {kind}, which NumPy cannot take ({shortened(error)}); expected an array"
            " of real numbers"
        ) from None
    if array.dtype.kind not in "biuf":
        raise OmnistereoError(f"{name} holds {array.dtype}; expected real numbers")
    if np.ma.is_masked(value):
        raise OmnistereoError(f"{name} has masked values; expected none. Fill them: .filled(…)")
    return array.astype(dtype or array.dtype.newbyteorder("="), copy=False)
