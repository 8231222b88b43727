"""sherf: a photo of a person in, an animatable person out.

    import sherf
    avatar = sherf.Avatar.from_photo("me.jpg")
    frame = avatar.render(azimuth_rad=0.5, background=(1, 1, 1))  # frame.color: height x width x 3
    avatar.export("me.glb")

Conventions are those of sherf.h: pictures are height x width x channels, RGB, float32 in [0, 1]; lengths are metres,
angles radians, rotations axis-angle or 3 x 3 matrices; cameras have OpenCV's axes, ``x_camera = R @ x_world + T``.
Whatever the library refuses raises :class:`sherf.Error` with the library's line as its text.
"""

from __future__ import annotations

import os

from ._context import Context, default_context, path_bytes, text_of
from ._library import LIBRARY as _LIBRARY
from ._library import VERSION as __version__
from .avatars import AnimateFacts, Avatar, ExportFacts, Frame, Motion
from .errors import (BadArgument, BadFile, Cancelled, Closed, Error, Mismatch, NoFile, NoMemory, Unsupported,
                     WriteFailed)
from .people import (Body, ClipFacts, Estimate, EstimateFacts, Estimator, Model, Observation, asset, estimate_clip)
from .scene import Camera, Pose, read_image, write_image

__all__ = ["AnimateFacts", "Avatar", "BadArgument", "BadFile", "Body", "Camera", "Cancelled", "ClipFacts", "Closed",
           "Context", "Error", "Estimate", "EstimateFacts", "Estimator", "ExportFacts", "Frame", "Mismatch", "Model",
           "Motion", "NoFile", "NoMemory", "Observation", "Pose", "Unsupported", "WriteFailed", "__version__", "asset",
           "convert", "default_context", "estimate_clip", "info", "read_image", "version", "write_image"]


def version() -> str:
    """The library's version."""
    return str(_LIBRARY.sherf_version().decode())


def info(path: str | os.PathLike[str], *, json: bool = False, context: Context | None = None) -> str:
    """Text, or JSON, about any file that sherf knows."""
    return text_of(context, "sherf_info", path_bytes(path), 1 if json else 0)


def convert(source: str | os.PathLike[str], output: str | os.PathLike[str], *, context: Context | None = None) -> str:
    """Converts an SMPL file, an authors' snapshot or a torch state dict to .safetensors; says what it was."""
    return text_of(context, "sherf_convert", path_bytes(source, "source"), path_bytes(output, "output"))
