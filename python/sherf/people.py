"""Everything needed to make an avatar from a picture: bodies, models, observations and estimates."""

from __future__ import annotations

import os
from collections.abc import Callable
from ctypes import POINTER, Structure, byref, c_float
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ._arrays import FloatArray, UInt8Array, array_of, image_of, picture, real, whole
from ._context import Context, context_or_default, make, path_bytes
from ._handle import Object, using
from ._library import LIBRARY, WARNINGS, ClipFactsStruct, ClipOptions, EstimateOptions, assets_folders
from .errors import NoFile
from .scene import Camera, Pose



def asset(name: str) -> Path:
    """The path of a file that ships with sherf.

    name: "body.safetensors", "models/people.safetensors" or "models/blazepose.safetensors". Raises `sherf.NoFile`.
    """
    folders = assets_folders()
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    raise NoFile(f"{name} is not among the assets (looked in {', '.join(map(str, folders))}; set SHERF_ASSETS)")


def fields_of(struct: Structure) -> dict[str, Any]:
    """The fields of a struct of numbers by name; arrays become tuples."""
    values = ((name, getattr(struct, name)) for name, *_ in struct._fields_)
    return {name: value if isinstance(value, (int, float)) else tuple(value) for name, value in values}


class Body(Object):
    """A body model: the open body that ships with sherf, or an SMPL file."""

    @classmethod
    def load(cls, path: str | os.PathLike[str] | None = None, *, context: Context | None = None) -> Body:
        """Loads an SMPL file (.pkl, .npz) or .safetensors; None means the open body.

        Raises `sherf.NoFile` or `sherf.BadFile`.
        """
        path = asset("body.safetensors") if path is None else path
        return cls._of(make(context, "sherf_body_load", path_bytes(path)), LIBRARY.sherf_body_free)

    @property
    def vertex_count(self) -> int:
        """The number of vertices V of the mesh."""
        with self._handle.use() as body:
            return int(LIBRARY.sherf_body_vertex_count(body))

    @property
    def faces(self) -> npt.NDArray[np.uint32]:
        """The vertex indices of each triangle, F x 3, uint32; a copy."""
        with self._handle.use() as body:
            count = LIBRARY.sherf_body_face_count(body)
            return np.ctypeslib.as_array(LIBRARY.sherf_body_faces(body), (count, 3)).copy()

    def pose(self, pose: Pose, *, context: Context | None = None) -> tuple[FloatArray, FloatArray]:
        """The posed mesh in world coordinates, metres: vertices V x 3 and joints 24 x 3, float32."""
        vertices, joints = np.empty((self.vertex_count, 3), np.float32), np.empty((24, 3), np.float32)
        with using((self, Body)) as (body,):
            context_or_default(context).run("sherf_body_pose", body, byref(struct_of(pose, Pose)), _data(vertices),
                                            _data(joints))
        return vertices, joints


def _data(array: FloatArray) -> Any:
    """A pointer to an array's floats; the array must outlive it."""
    return array.ctypes.data_as(POINTER(c_float))


def struct_of(thing: Any, kind: type[Pose] | type[Camera]) -> Any:
    """The library's struct of a pose or camera. Raises TypeError if `thing` is not a `kind`."""
    if not isinstance(thing, kind):
        raise TypeError(f"expected a sherf.{kind.__name__}, not {type(thing).__name__}")
    return thing.struct()


class Model(Object):
    """A network's weights: the model that ships with sherf, or a trained or converted file."""

    @classmethod
    def load(cls, path: str | os.PathLike[str] | None = None, *, context: Context | None = None) -> Model:
        """Loads weights (.safetensors); None means the model that ships.

        Raises `sherf.NoFile` or `sherf.BadFile`, and `sherf.Mismatch` if tensors are missing or have other shapes.
        """
        path = asset("models/people.safetensors") if path is None else path
        return cls._of(make(context, "sherf_model_load", path_bytes(path)), LIBRARY.sherf_model_free)

    @classmethod
    def create(cls, preset: str = "small", seed: int = 0, *, context: Context | None = None) -> Model:
        """Creates a network with random weights.

        preset: "paper", "base" or "small", optionally with settings, as in "small,plane_resolution=64". seed: 0 to
        2**64 - 1. Raises `sherf.BadArgument` for an unknown preset or setting.
        """
        encoded = text_bytes(preset, "preset")
        seed = whole(seed, 0, 2**64 - 1, "seed")
        return cls._of(make(context, "sherf_model_create", encoded, seed), LIBRARY.sherf_model_free)

    def save(self, path: str | os.PathLike[str], *, context: Context | None = None) -> None:
        """Writes the weights as .safetensors. Raises `sherf.WriteFailed`."""
        with using((self, Model)) as (model,):
            context_or_default(context).run("sherf_model_save", model, path_bytes(path))

    @property
    def parameter_count(self) -> int:
        """The number of weights."""
        with self._handle.use() as model:
            return int(LIBRARY.sherf_model_parameter_count(model))


def text_bytes(text: str | None, what: str) -> bytes | None:
    """A string as UTF-8 bytes, or None. Raises TypeError."""
    if text is None:
        return None
    if not isinstance(text, str) or "\0" in text:
        raise TypeError(f"{what}: {text!r} is no text")
    return text.encode()


class _Pictured(Object):
    """Base class of objects with a picture, its camera and the body's pose."""

    _image: Callable[..., Any]
    _camera: Callable[..., Any]
    _pose: Callable[..., Any]

    @property
    def image(self) -> FloatArray:
        """The picture, height x width x 3, float32 in [0, 1]; a copy. An observation's is black outside its mask."""
        with self._handle.use() as pointer:
            return array_of(type(self)._image(pointer).contents)

    @property
    def camera(self) -> Camera:
        """The picture's camera; a copy."""
        with self._handle.use() as pointer:
            return Camera.of_struct(type(self)._camera(pointer).contents)

    @property
    def pose(self) -> Pose:
        """The body's pose and shape; a copy."""
        with self._handle.use() as pointer:
            return Pose.of_struct(type(self)._pose(pointer).contents)


class Observation(_Pictured):
    """One picture of a person: image, mask, camera, body pose and shape."""

    _image, _camera, _pose = (LIBRARY.sherf_observation_image, LIBRARY.sherf_observation_camera,
                              LIBRARY.sherf_observation_pose)

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, context: Context | None = None) -> Observation:
        """Loads a folder or JSON file (docs/observation.md), or a picture of a data set as "DATA#PERSON/POSE/VIEW".

        Raises `sherf.NoFile` or `sherf.BadFile`, and `sherf.Mismatch` if mask and picture differ in size.
        """
        return cls._of(make(context, "sherf_observation_load", path_bytes(path)), LIBRARY.sherf_observation_free)

    @classmethod
    def create(cls, image: FloatArray | UInt8Array, mask: npt.ArrayLike, camera: Camera, pose: Pose, *,
               context: Context | None = None) -> Observation:
        """Makes an observation from arrays, which are copied.

        image: height x width x 3, RGB, uint8 or floats in [0, 1]. mask: height x width; any value but 0 is the person.
        """
        pixels, inside = picture(image, 3, "image"), picture(mask, 1, "mask")
        pointer = make(context, "sherf_observation_create", byref(image_of(pixels)), byref(image_of(inside)),
                       byref(struct_of(camera, Camera)), byref(struct_of(pose, Pose)))
        return cls._of(pointer, LIBRARY.sherf_observation_free)

    def crop(self, model: Model, body: Body, *, context: Context | None = None) -> Observation:
        """A new observation, cropped to the person and scaled to the size of people that `model` was trained on."""
        with using((model, Model), (body, Body), (self, Observation)) as pointers:
            pointer = make(context, "sherf_observation_crop", *pointers)
        return Observation._of(pointer, LIBRARY.sherf_observation_free)


class EstimateFacts(NamedTuple):
    """What was found in a photo. Pixels are those of the estimate's picture."""

    people: int  # number of people found
    person: int  # the one chosen, counted from 1
    warnings: tuple[str, ...]  # from_behind, cut_feet, cut_head, small, hidden_arms, poor, mask_cut
    width_px: int
    height_px: int
    box_px: tuple[float, float, float, float]  # left, top, right and bottom of the person
    person_px: float  # height of the person, head to feet
    focal_px: float
    pitch_deg: float  # how far the camera looks down
    lean_deg: float  # how far the trunk leans forward
    landmarks_off: float  # mean distance from the landmarks to the body's, as a share of person_px
    mask_covered: float  # share of the mask that the body covers
    body_inside: float  # share of the body that is inside the mask
    find_ms: float
    mask_ms: float
    fit_ms: float


class Estimate(_Pictured):
    """A person found in a photo: mask, camera, body pose and shape. Its `image` includes the background."""

    _image, _camera, _pose = (LIBRARY.sherf_estimate_image, LIBRARY.sherf_estimate_camera, LIBRARY.sherf_estimate_pose)
    _body: Body

    @property
    def mask(self) -> FloatArray:
        """How much of each pixel belongs to the person: height x width, float32 in [0, 1]; a copy."""
        with self._handle.use() as pointer:
            return array_of(LIBRARY.sherf_estimate_mask(pointer).contents)

    @property
    def facts(self) -> EstimateFacts:
        """What was found, and how well it fits."""
        with self._handle.use() as pointer:
            values = fields_of(LIBRARY.sherf_estimate_found(pointer).contents)
        values["warnings"] = tuple(name for i, name in enumerate(WARNINGS) if values["warnings"] >> i & 1)
        return EstimateFacts(**values)

    def observation(self, *, context: Context | None = None) -> Observation:
        """A new observation to make an avatar from. The person is where the mask is at least 0.5."""
        with using((self, Estimate)) as (estimate,):
            pointer = make(context, "sherf_estimate_observation", estimate)
        return Observation._of(pointer, LIBRARY.sherf_observation_free)

    def save(self, folder: str | os.PathLike[str], *, context: Context | None = None) -> None:
        """Writes a folder that can be loaded as an observation, to inspect and correct (docs/photo.md)."""
        self._write("sherf_estimate_save", folder, context)

    def overlay(self, path: str | os.PathLike[str], *, context: Context | None = None) -> None:
        """Writes a PNG of the body drawn over the photo. Raises `sherf.WriteFailed`."""
        self._write("sherf_estimate_overlay", path, context)

    def _write(self, function: str, path: Any, context: Context | None) -> None:
        """Calls a function that writes the estimate to `path`."""
        with using((self, Estimate), (self._body, Body)) as pointers:
            context_or_default(context).run(function, *pointers, path_bytes(path))


class Estimator(Object):
    """The networks that find people in photos."""

    @classmethod
    def load(cls, path: str | os.PathLike[str] | None = None, *, context: Context | None = None) -> Estimator:
        """Loads blazepose.safetensors; None means the file that ships. Raises `sherf.NoFile`, `sherf.BadFile`."""
        path = asset("models/blazepose.safetensors") if path is None else path
        return cls._of(make(context, "sherf_estimator_load", path_bytes(path)), LIBRARY.sherf_estimator_free)

    def estimate(self, photo: str | os.PathLike[str] | FloatArray | UInt8Array, body: Body, *, person: int = 0,
                 focal_px: float = 0, mask: Any = None, context: Context | None = None) -> Estimate:
        """Finds the person in a photo. Raises `sherf.Mismatch` if nobody is found.

        photo: a file, or an array height x width x 3, RGB, uint8 or floats in [0, 1], at most 2048 pixels on a side.
        person: 1 is the largest person, 2 the next; 0 is the largest, or the one that the mask shows.
        focal_px: focal length in pixels of the full-size photo; 0: from the file, otherwise estimated.
        mask: where the person is: a file if `photo` is a file, an array height x width if it is an array.
        """
        options = EstimateOptions(whole(person, 0, 8, "person"), real(focal_px, "focal_px"))
        with using((self, Estimator), (body, Body)) as pointers:
            if isinstance(photo, (str, bytes, os.PathLike)):
                options.mask = None if mask is None else path_bytes(mask, "mask")
                pointer = make(context, "sherf_estimate_photo", *pointers, path_bytes(photo, "photo"), byref(options))
            else:
                pixels = picture(photo, 3, "photo")
                cut = None if mask is None else picture(mask, 1, "mask")
                pointer = make(context, "sherf_estimate_picture", *pointers, byref(image_of(pixels)),
                               None if cut is None else byref(image_of(cut)), byref(options))
        estimate = Estimate._of(pointer, LIBRARY.sherf_estimate_free)
        estimate._body = body
        return estimate


class ClipFacts(NamedTuple):
    """What was found in a video. Pixels are those of the upright video."""

    frames: int  # frames of the motion
    fps: float
    people: int  # people in the first frame that shows anybody
    filled: int  # frames in which the person was not found
    filled_longest: int  # the longest run of such frames
    repaired: int  # frames turned round because the networks took front for back
    left_out: int  # frames of the video before and after those of the motion
    poor: int  # frames in which the body fits the person badly
    cuts: int  # cuts of the video; the motion is of the shot that shows the person longest
    start_s: float  # of the motion's first frame in the video
    focal_px: float
    pitch_rad: float  # how far the camera looks down
    roll_rad: float  # how far the camera is rolled clockwise
    landmarks: float  # mean distance from body to landmarks, as a share of its height in the picture
    shapes: tuple[float, ...]  # 10 shape components
    seconds: tuple[float, float, float]  # reading frames and running networks; fitting; smoothing


def estimate_clip(video: str | os.PathLike[str], output: str | os.PathLike[str], *, body: Body | None = None,
                  person: int = 0, focal_px: float = 0, fps: float = 0, smooth: float = 0,
                  networks: str | os.PathLike[str] | None = None, context: Context | None = None) -> ClipFacts:
    """Turns a video of one person, taken by a fixed camera, into a motion file (.npz) for `sherf.Motion.load`.

    body: None means the open body. networks: None means the blazepose.safetensors that ships.
    person: in the first frame that shows anybody, 0 is the largest person, 1 the next, and so on.
    focal_px: focal length in pixels of the upright video; 0: estimated.
    fps: frame rate of the motion, at most 60; 0: the video's, divided by a whole number if it is above 60.
    smooth: 0 or 1: the usual filter; 2: half its bandwidth; 0.5: twice its bandwidth; negative: no smoothing.

    Raises `sherf.BadFile` if the video cannot be read or shows nobody.
    """
    body = Body.load(context=context) if body is None else body
    networks = asset("models/blazepose.safetensors") if networks is None else networks
    options = ClipOptions(whole(person, 0, 8, "person"), real(focal_px, "focal_px"), real(fps, "fps"),
                          real(smooth, "smooth"))
    facts = ClipFactsStruct()
    with using((body, Body)) as (pointer,):
        context_or_default(context).run("sherf_estimate_clip", path_bytes(networks, "networks"), pointer,
                                        path_bytes(video, "video"), byref(options), path_bytes(output, "output"),
                                        byref(facts))
    return ClipFacts(**fields_of(facts))
