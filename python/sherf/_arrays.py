"""Converts NumPy arrays to the library's structs and back. Arrays are checked before the library sees them."""

from __future__ import annotations

import operator
from ctypes import POINTER, c_float
from typing import Any

import numpy as np
import numpy.typing as npt

from ._library import ImageStruct

FloatArray = npt.NDArray[np.float32]
UInt8Array = npt.NDArray[np.uint8]
_FLOATS = POINTER(c_float)
_LARGEST = 65535  # pixels on a side


def _shape_text(shape: tuple[int, ...]) -> str:
    """A shape in words: "24 x 3"."""
    return " x ".join(map(str, shape)) if shape else "a single number"


def numbers(value: Any, what: str) -> npt.NDArray[Any]:
    """`value` as an array of real numbers of any shape. Raises TypeError or ValueError, naming `what`."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{what}: no array can be made of it ({error})") from None
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{what}: expected numbers, not {array.dtype}")
    return array


def floats(value: Any, shape: tuple[int, ...], what: str) -> FloatArray:
    """A new finite float32 array of `shape`; `value` has that shape or is flat. Raises TypeError or ValueError."""
    array = numbers(value, what)
    if array.shape != shape and array.shape != (int(np.prod(shape)),):
        raise ValueError(f"{what}: expected {_shape_text(shape)} numbers, not {_shape_text(array.shape)}")
    with np.errstate(over="ignore"):
        out = np.array(array, np.float32, order="C").reshape(shape)
    if not np.isfinite(out).all():
        raise ValueError(f"{what}: there are numbers in it that are not finite")
    return out


def picture(value: Any, channels: int, what: str) -> FloatArray:
    """A picture as float32 in [0, 1], height x width x channels. One channel may also be given as height x width.

    uint8 is divided by 255; bool becomes 0 or 1; floats must be in [0, 1]. Raises TypeError or ValueError.
    """
    array = numbers(value, what)
    if channels == 1 and array.ndim == 2:
        array = array[:, :, None]
    if array.ndim != 3 or array.shape[2] != channels:
        wanted = "height x width" + (f" x {channels}" if channels > 1 else "")
        raise ValueError(f"{what}: expected {wanted}, not {_shape_text(array.shape)}")
    if not 1 <= min(array.shape[:2]) <= max(array.shape[:2]) <= _LARGEST:
        raise ValueError(f"{what}: {_shape_text(array.shape[:2])} pixels are none or too many")
    if array.dtype == np.uint8:
        return np.ascontiguousarray(array, np.float32) / np.float32(255)
    if array.dtype.kind in "iu":
        raise TypeError(f"{what}: expected uint8 (0 to 255), bool or floats (0 to 1), not {array.dtype}")
    with np.errstate(over="ignore"):
        out = np.array(array, np.float32, order="C")
    if not np.isfinite(out).all():
        raise ValueError(f"{what}: there are numbers in it that are not finite")
    if out.min() < 0 or out.max() > 1:
        raise ValueError(f"{what}: floats are 0 to 1, and these are {out.min():g} to {out.max():g}")
    return out


def image_of(array: FloatArray) -> ImageStruct:
    """The library's struct for an array returned by `picture`. It points into the array, which must outlive it."""
    height, width, channels = array.shape
    return ImageStruct(width, height, channels, array.ctypes.data_as(_FLOATS))


def array_of(image: ImageStruct) -> FloatArray:
    """A copy of one of the library's pictures: height x width x channels, or height x width for one channel."""
    shape = (image.height, image.width, image.channels)
    out = np.ctypeslib.as_array(image.data, shape).astype(np.float32, copy=True)
    return out[:, :, 0] if image.channels == 1 else out


def to_uint8(array: FloatArray) -> UInt8Array:
    """Clips floats to [0, 1] and scales them to 0 to 255, rounded."""
    return (np.clip(array, 0, 1) * 255 + 0.5).astype(np.uint8)


def whole(value: Any, low: int, high: int, what: str) -> int:
    """`value` as an int from `low` to `high`. Raises TypeError or ValueError."""
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{what}: expected a whole number, not {value!r}") from None
    if not low <= number <= high:
        raise ValueError(f"{what}: {number} is not {low} to {high}")
    return number


def real(value: Any, what: str) -> float:
    """`value` as a finite float. Raises TypeError or ValueError."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"{what}: expected a number, not {value!r}") from None
    if not np.isfinite(number):
        raise ValueError(f"{what}: {number} is not finite")
    return number


def size_of(value: Any, what: str = "size") -> tuple[int, int]:
    """(width, height) in pixels, from one number or two. Raises TypeError or ValueError."""
    pair = value if isinstance(value, (tuple, list)) else (value, value)
    if len(pair) != 2:
        raise ValueError(f"{what}: expected one number or (width, height), not {value!r}")
    return whole(pair[0], 1, _LARGEST, what), whole(pair[1], 1, _LARGEST, what)
