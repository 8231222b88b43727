"""sherf makes an animatable person from a photo.

    import sherf
    avatar = sherf.Avatar.from_photo("me.jpg")
    frame = avatar.render(azimuth_rad=0.5, background=(1, 1, 1))  # frame.color: height x width x 3
    avatar.export("me.glb")

The conventions are those of sherf.h. Pictures are height x width x channels, RGB, float32 in [0, 1]. Lengths are in
metres and angles in radians; rotations are axis-angle vectors or 3 x 3 matrices. Cameras have OpenCV's axes:
``x_camera = R @ x_world + T``. Returned arrays are copies.

If the library refuses something, :class:`sherf.Error` is raised with the library's one-line message. Arguments of the
wrong type, shape or range raise ``TypeError`` or ``ValueError`` before the library is called. In every function,
``context`` is the :class:`sherf.Context` that computes; None means :func:`sherf.default_context`.
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
    """The library's version, such as "0.1.0"."""
    return str(_LIBRARY.sherf_version().decode())


def info(path: str | os.PathLike[str], *, json: bool = False, context: Context | None = None) -> str:
    """Describes any file that sherf recognises, as text or, with ``json=True``, as a JSON string.

    Raises `sherf.NoFile` if the file cannot be opened and `sherf.BadFile` if it is damaged or of an unknown kind.
    """
    return text_of(context, "sherf_info", path_bytes(path), 1 if json else 0)


def convert(source: str | os.PathLike[str], output: str | os.PathLike[str], *, context: Context | None = None) -> str:
    """Converts an SMPL file, a snapshot of the SHERF authors, a torch state dict or a TensorFlow.js model folder to
    .safetensors.

    The source is recognised by its content. Returns one line that says what it was. Raises `sherf.BadFile` if the
    source is damaged or of an unknown kind.
    """
    return text_of(context, "sherf_convert", path_bytes(source, "source"), path_bytes(output, "output"))
