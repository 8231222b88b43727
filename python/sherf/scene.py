"""Plain data: cameras, poses and pictures."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from ctypes import POINTER, byref, c_float, c_int, cast, c_void_p
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from ._arrays import FloatArray, UInt8Array, array_of, floats, image_of, numbers, picture, real, size_of, whole
from ._context import Context, context_or_default, path_bytes
from ._library import LIBRARY, CameraStruct, ImageStruct, PoseStruct

_Thing = TypeVar("_Thing")


def _identity() -> FloatArray:
    """A new 3 x 3 identity."""
    return np.eye(3, dtype=np.float32)


def _zeros(*shape: int) -> Callable[[], FloatArray]:
    """A function that makes new zeros, for a dataclass's default."""
    return lambda: np.zeros(shape, np.float32)


@dataclass(eq=False)
class Camera:
    """A camera with OpenCV's axes: x right, y down, z forward; ``x_camera = R @ x_world + T``, metres.

    K: 3 x 3, pixels; the centre of the pixel in column i and row j is at (i, j). R: 3 x 3, a rotation. T: 3, metres.
    width, height: pixels; 0 if a file does not give them. Arrays are copied. Raises TypeError or ValueError.
    """

    K: FloatArray
    R: FloatArray = field(default_factory=_identity)
    T: FloatArray = field(default_factory=_zeros(3))
    width: int = 0
    height: int = 0

    def __post_init__(self) -> None:
        """Copies and checks the fields."""
        self.K, self.R, self.T = floats(self.K, (3, 3), "K"), floats(self.R, (3, 3), "R"), floats(self.T, (3,), "T")
        self.struct()

    def struct(self) -> CameraStruct:
        """The library's struct. Checks the camera again, because its fields may have been changed."""
        out = CameraStruct(whole(self.width, 0, 65535, "width"), whole(self.height, 0, 65535, "height"))
        out.K[:] = floats(self.K, (3, 3), "K").ravel().tolist()
        out.R[:] = floats(self.R, (3, 3), "R").ravel().tolist()
        out.T_m[:] = floats(self.T, (3,), "T").tolist()
        return out

    @classmethod
    def of_struct(cls, c: CameraStruct) -> Camera:
        """Makes one from the library's struct; arrays are copied."""
        return cls(np.array(c.K, np.float32).reshape(3, 3), np.array(c.R, np.float32).reshape(3, 3),
                   np.array(c.T_m, np.float32), c.width_px, c.height_px)

    @classmethod
    def orbit(cls, centre: Sequence[float] = (0, 0, 0), distance_m: float = 3, azimuth_rad: float = 0,
              elevation_rad: float = 0, fov_rad: float = 0.8, size: int | tuple[int, int] = 512) -> Camera:
        """A camera that looks at `centre` (3, metres) from `distance_m`.

        Azimuth 0 looks from +z; elevation is above the horizon; y is up; `fov_rad` is vertical. size: pixels, one
        number or (width, height).
        """
        middle = floats(centre, (3,), "centre")
        width, height = size_of(size)
        out = CameraStruct()
        LIBRARY.sherf_camera_orbit(middle.ctypes.data_as(POINTER(c_float)), real(distance_m, "distance_m"),
                                   real(azimuth_rad, "azimuth_rad"), real(elevation_rad, "elevation_rad"),
                                   real(fov_rad, "fov_rad"), width, height, byref(out))
        return cls.of_struct(out)

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, context: Context | None = None) -> list[Camera]:
        """All cameras of a JSON file ``{"cameras": [...]}`` or a data set's cameras.json.

        Raises `sherf.NoFile` or `sherf.BadFile`.
        """
        return _load(cls.of_struct, CameraStruct, "sherf_cameras_load", path, context)


@dataclass(eq=False)
class Pose:
    """A body's pose and shape: ``x_world = R @ x_body + Th``.

    poses: 24 x 3, the joints' axis-angle vectors in radians; joint 0 is the root. shapes: 10. R: 3 x 3, a rotation.
    Th: 3, metres. ``Pose()`` is the rest pose with the mean shape at the origin. Arrays are copied. Raises TypeError or
    ValueError.
    """

    poses: FloatArray = field(default_factory=_zeros(24, 3))
    shapes: FloatArray = field(default_factory=_zeros(10))
    R: FloatArray = field(default_factory=_identity)
    Th: FloatArray = field(default_factory=_zeros(3))

    def __post_init__(self) -> None:
        """Copies and checks the fields."""
        self.poses, self.shapes = floats(self.poses, (24, 3), "poses"), floats(self.shapes, (10,), "shapes")
        self.R, self.Th = floats(self.R, (3, 3), "R"), floats(self.Th, (3,), "Th")

    def struct(self) -> PoseStruct:
        """The library's struct. Checks the pose again, because its fields may have been changed."""
        out = PoseStruct()
        out.poses_rad[:] = floats(self.poses, (24, 3), "poses").ravel().tolist()
        out.shapes[:] = floats(self.shapes, (10,), "shapes").tolist()
        out.R[:] = floats(self.R, (3, 3), "R").ravel().tolist()
        out.Th_m[:] = floats(self.Th, (3,), "Th").tolist()
        return out

    @classmethod
    def of_struct(cls, p: PoseStruct) -> Pose:
        """Makes one from the library's struct; arrays are copied."""
        return cls(np.array(p.poses_rad, np.float32).reshape(24, 3), np.array(p.shapes, np.float32),
                   np.array(p.R, np.float32).reshape(3, 3), np.array(p.Th_m, np.float32))

    def copy(self) -> Pose:
        """A copy with its own arrays."""
        return Pose(self.poses, self.shapes, self.R, self.Th)

    @classmethod
    def canonical(cls) -> Pose:
        """The "big pose" with arms and legs spread, in which an avatar's features are stored."""
        out = PoseStruct()
        LIBRARY.sherf_pose_canonical(byref(out))
        return cls.of_struct(out)

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, context: Context | None = None) -> list[Pose]:
        """All poses of an .npz, .npy or JSON file (docs/observation.md). Raises `sherf.NoFile`, `sherf.BadFile`."""
        return _load(cls.of_struct, PoseStruct, "sherf_poses_load", path, context)


def _load(make: Callable[[Any], _Thing], struct: Any, function: str, path: Any,
          context: Context | None) -> list[_Thing]:
    """Calls a function that allocates an array of `struct`. Returns the array as a list and frees it."""
    array, count = POINTER(struct)(), c_int()
    try:
        context_or_default(context).run(function, path_bytes(path), byref(array), byref(count))
        return [make(array[i]) for i in range(count.value)]
    finally:
        LIBRARY.sherf_free(cast(array, c_void_p))


def read_image(path: str | os.PathLike[str], *, context: Context | None = None) -> FloatArray:
    """Reads a PNG, JPEG, WebP, HEIC or AVIF file, turned upright: height x width x 3, RGB, float32 in [0, 1].

    Raises `sherf.NoFile` or `sherf.BadFile`.
    """
    image = ImageStruct()
    try:
        context_or_default(context).run("sherf_image_read", path_bytes(path), byref(image))
        return array_of(image)
    finally:
        LIBRARY.sherf_image_free(byref(image))


def write_image(path: str | os.PathLike[str], image: FloatArray | UInt8Array, *,
                context: Context | None = None) -> None:
    """Writes a picture to .png, .jpg or .webp.

    image: height x width, or x 3 (RGB), or x 4 (alpha, not premultiplied); uint8 or floats in [0, 1]. Raises
    `sherf.WriteFailed`.
    """
    shape = numbers(image, "image").shape
    channels = shape[2] if len(shape) == 3 and shape[2] in (1, 3, 4) else 1 if len(shape) == 2 else 3
    array = picture(image, channels, "image")
    context_or_default(context).run("sherf_image_write", path_bytes(path), byref(image_of(array)))
