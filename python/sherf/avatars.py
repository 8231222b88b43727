"""Avatars, their frames and files, and the motions that animate them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from ctypes import POINTER, byref, c_float, c_void_p, pointer
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ._arrays import FloatArray, UInt8Array, array_of, floats, real, size_of, to_uint8, whole
from ._context import Context, choice, context_or_default, make, path_bytes
from ._handle import Object, using
from ._library import (CAMERA_PATHS, LIBRARY, ROOTS, ROTATIONS, UPS, AnimateOptions, AnimateResult, CameraStruct,
                       BakeOptions, ExportedStruct, ExportOptions, FrameStruct, MotionOptions, OrbitOptions, PoseStruct,
                       RenderOptions)
from .people import Body, Estimate, Estimator, Model, Observation, fields_of, struct_of, text_bytes
from .scene import Camera, Pose, write_image

Color = Sequence[float]
PICTURES_MAX = 8  # per avatar; SHERF_PICTURES_MAX


class Motion(Object):
    """A motion of the 24 joints. ``len(motion)`` is the number of frames and ``motion[i]`` a frame's pose. Iterable."""

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, up: str = "auto", rotations: str = "auto", scale: float = 0,
             source_fps: float = 0, fps: float = 0, fps_max: float = 0, track: str | None = None, first: int = 0,
             last: int = 0, root: str = "kept", smooth_s: float = 0, loop: bool = False, start: Pose | None = None,
             blend_s: float = 0, body: Body | None = None, shapes: Any = None, their_shape: bool = False,
             joints: str | os.PathLike[str] | None = None, context: Context | None = None) -> Motion:
        """Loads a file or folder, recognised by its content (docs/motion.md): AMASS, AIST++, GVHMR, WHAM, BVH, FBX, ...

        up: the file's up axis: "auto", "y", "z" or "-y".
        rotations: the file's kind of rotations: "auto", "axis-angle", "matrix", "wxyz", "xyzw",
                "6d-rows" or "6d-columns".
        scale: metres per unit of the file; 0: detected.
        source_fps: the file's frames per second; 0: as the file says, otherwise its format's usual rate.
        fps: frames per second of the motion; 0: the source's. fps_max: with fps 0, the source's rate is divided by the
            smallest whole number that brings it down to this; 0: no limit.
        track: the person in a file with several; None: the one present longest.
        first, last: frames of the file, counted from 0, both included; last 0: to the end.
        root: "kept" as in the file, "dropped" to stay above one spot, "grounded" to stand on the ground in every frame.
        smooth_s: standard deviation in seconds of a Gaussian over time; 0: none.
        loop: makes the end meet the start.
        start: the pose where the motion begins, which also gives the direction it faces (usually ``avatar.pose``).
        blend_s: seconds in which `start` turns into the first frame, put before it; 0: none.
        body, shapes (10): the body that moves; None: an average one with shapes 0.
        their_shape: uses the file's body shape, if it has one, instead of `shapes`.
        joints: a JSON file that maps SMPL's joint names to those of a BVH (docs/motion.md).

        Raises `sherf.NoFile`, `sherf.BadFile` if the file is damaged or not a motion, and `sherf.BadArgument`.
        """
        beginning = None if start is None else struct_of(start, Pose)
        shape = None if shapes is None else floats(shapes, (10,), "shapes")
        o = MotionOptions(choice(up, UPS, "up"), choice(rotations, ROTATIONS, "rotations"), real(scale, "scale"),
                          real(source_fps, "source_fps"), real(fps, "fps"), real(fps_max, "fps_max"),
                          text_bytes(track, "track"), whole(first, 0, 2**31 - 1, "first"),
                          whole(last, 0, 2**31 - 1, "last"), choice(root, ROOTS, "root"), real(smooth_s, "smooth_s"),
                          bool(loop))
        o.blend_s, o.their_shape = real(blend_s, "blend_s"), bool(their_shape)
        o.joints = None if joints is None else path_bytes(joints, "joints")
        if beginning is not None:
            o.start = pointer(beginning)
        if shape is not None:
            o.shapes = shape.ctypes.data_as(POINTER(c_float))
        with using((body, Body)) as (o.body,):
            return cls._of(make(context, "sherf_motion_load", path_bytes(path), byref(o)), LIBRARY.sherf_motion_free)

    def __len__(self) -> int:
        """The number of frames."""
        with self._handle.use() as motion:
            return int(LIBRARY.sherf_motion_frame_count(motion))

    def __getitem__(self, frame: int) -> Pose:
        """The pose of a frame; negative numbers count from the end. Raises IndexError."""
        count = len(self)
        frame = whole(frame, -(2**31), 2**31 - 1, "frame")
        if not -count <= frame < count:
            raise IndexError(f"frame {frame} of a motion of {count}")
        out = PoseStruct()
        with self._handle.use() as motion:
            LIBRARY.sherf_motion_pose(motion, frame % count, byref(out))
        return Pose.of_struct(out)

    def at(self, seconds: float) -> Pose:
        """The pose at any time, interpolated between frames. At the end a loop starts again; other motions stop."""
        out = PoseStruct()
        with self._handle.use() as motion:
            LIBRARY.sherf_motion_pose_at(motion, real(seconds, "seconds"), byref(out))
        return Pose.of_struct(out)

    @property
    def fps(self) -> float:
        """Frames per second."""
        with self._handle.use() as motion:
            return float(LIBRARY.sherf_motion_fps(motion))

    @property
    def description(self) -> str:
        """One line that says what was recognised."""
        with self._handle.use() as motion:
            return str(LIBRARY.sherf_motion_description(motion).decode("utf-8", "replace"))

    def save(self, path: str | os.PathLike[str], *, context: Context | None = None) -> None:
        """Writes .npz (AMASS's form), .bvh or .glb. Raises `sherf.WriteFailed`."""
        with using((self, Motion)) as (motion,):
            context_or_default(context).run("sherf_motion_save", motion, path_bytes(path))


class Frame:
    """A rendered picture. A notebook displays it.

    color: height x width x 3, RGB, float32 in [0, 1], over the background.
    opacity: height x width, float32 in [0, 1].
    depth: height x width, float32, metres along the camera's axis.
    points: the number of samples at which the network was queried.
    """

    def __init__(self, color: FloatArray, opacity: FloatArray, depth: FloatArray, points: int, black: bool) -> None:
        self.color, self.opacity, self.depth, self.points, self._black = color, opacity, depth, points, black

    def rgba(self) -> FloatArray:
        """Height x width x 4, float32 in [0, 1], alpha not premultiplied. ValueError unless rendered over black."""
        if not self._black:
            raise ValueError("alpha is of frames over black: render with background=(0, 0, 0)")
        opacity = np.clip(self.opacity, 0, 1)[..., None]
        color = np.where(opacity > 1e-4, np.minimum(self.color / np.maximum(opacity, 1e-4), 1), 0)
        return np.concatenate([color, opacity], 2).astype(np.float32)

    def uint8(self, alpha: bool = False) -> UInt8Array:
        """Height x width x 3, or x 4 with `alpha`, uint8, as other packages expect pictures."""
        return to_uint8(self.rgba() if alpha else self.color)

    def save(self, path: str | os.PathLike[str], alpha: bool = False, *, context: Context | None = None) -> None:
        """Writes .png, .jpg or .webp. alpha: not for .jpg. Raises `sherf.WriteFailed`."""
        write_image(path, self.uint8(alpha), context=context)

    def _repr_png_(self) -> bytes:
        """The picture as PNG, which a notebook displays."""
        with tempfile.TemporaryDirectory() as folder:
            self.save(Path(folder) / "frame.png")
            return (Path(folder) / "frame.png").read_bytes()


class ExportFacts(NamedTuple):
    """What `Avatar.export` wrote."""

    vertices: int
    triangles: int
    splats: int
    level: float  # density of the surface, per metre
    islands: int  # components that were removed
    charts: int  # pieces of the texture
    seconds: tuple[float, float, float, float]  # density and surface; reduction; skin and charts; colours


class AnimateFacts(NamedTuple):
    """What `Avatar.animate` wrote."""

    frames: int  # frames written
    frame_ms: float  # rendering time per frame, on average
    points: float  # samples per frame at which the network was queried, on average


def _render_options(background: Color, samples: int, exact: bool, detail: bool) -> RenderOptions:
    """The library's struct. Raises TypeError or ValueError."""
    out = RenderOptions(samples=whole(samples, -2, 1024, "samples"), exact=bool(exact), detail=1 if detail else -1)
    color = floats(background, (3,), "background")
    if color.min() < 0 or color.max() > 1:
        raise ValueError("background: red, green and blue are 0 to 1")
    out.background[:] = color.tolist()
    return out


def _several(items: Any, what: str) -> Sequence[Any]:
    """`items` as a list of 1 to 8 elements. Raises TypeError or ValueError."""
    if isinstance(items, (str, bytes, os.PathLike)) or not hasattr(items, "__len__"):
        raise TypeError(f"{what}: a list is expected, not {items!r}")
    if not 1 <= len(items) <= PICTURES_MAX:
        raise ValueError(f"{what}: from 1 to {PICTURES_MAX}, not {len(items)}")
    if any(item is None for item in items):
        raise TypeError(f"{what}: one of them is None")
    return list(items)


class Avatar(Object):
    """A person from one or more pictures, who can be rendered from any camera in any pose."""

    body: Body  # the one it was made with
    _context: Context | None

    @classmethod
    def _made(cls, address: int, body: Body, context: Context | None) -> Avatar:
        """A new avatar that owns the library's avatar at `address`."""
        self = cls._of(address, LIBRARY.sherf_avatar_free)
        self.body, self._context = body, context
        return self

    @classmethod
    def from_photo(cls, photo: str | os.PathLike[str] | FloatArray | UInt8Array, *, body: Body | None = None,
                   model: Model | None = None, estimator: Estimator | None = None, person: int = 0, focal_px: float = 0,
                   mask: Any = None, context: Context | None = None) -> Avatar:
        """Makes an avatar from a photo. Arguments as in `Estimator.estimate`.

        body, model, estimator: None means the ones that ship. Raises `sherf.Mismatch` if nobody is found.
        """
        body = Body.load(context=context) if body is None else body
        estimator = Estimator.load(context=context) if estimator is None else estimator
        with estimator.estimate(photo, body, person=person, focal_px=focal_px, mask=mask, context=context) as found:
            with found.observation(context=context) as observation:
                return cls.from_observation(observation, body=body, model=model, context=context)

    @classmethod
    def from_observation(cls, observation: Observation, *, body: Body | None = None, model: Model | None = None,
                         crop: bool = True, context: Context | None = None) -> Avatar:
        """Makes an avatar from an observation. crop: first crops and scales it as `Observation.crop` does."""
        body = Body.load(context=context) if body is None else body
        model = Model.load(context=context) if model is None else model
        with using((model, Model), (body, Body), (observation, Observation)) as pointers:
            if not crop:
                return cls._made(make(context, "sherf_avatar_create", *pointers), body, context)
        with observation.crop(model, body, context=context) as cut:
            return cls.from_observation(cut, body=body, model=model, crop=False, context=context)

    @classmethod
    def from_photos(cls, photos: Sequence[str | os.PathLike[str] | FloatArray | UInt8Array], *,
                    body: Body | None = None, model: Model | None = None, estimator: Estimator | None = None,
                    focal_px: float = 0, context: Context | None = None) -> Avatar:
        """Makes an avatar from up to 8 photos of one person, who may stand in a different pose in each.

        Every part of the body is taken from the photo that shows it best. All photos get the same body shape. The
        avatar's pose and camera are those of the first photo. If a photo shows several people, the largest is used; for
        another person, use `Estimator.estimate` and `from_observations`. Raises `sherf.Mismatch` if nobody is found.
        """
        body = Body.load(context=context) if body is None else body
        estimator = Estimator.load(context=context) if estimator is None else estimator
        with ExitStack() as stack:
            found = [stack.enter_context(estimator.estimate(p, body, focal_px=focal_px, context=context))
                     for p in _several(photos, "photos")]
            with using((body, Body), *((f, Estimate) for f in found)) as (address, *pointers):
                context_or_default(context).run("sherf_estimate_share_shape", address, len(found),
                                                (c_void_p * len(found))(*pointers))
            observations = [stack.enter_context(f.observation(context=context)) for f in found]
            return cls.from_observations(observations, body=body, model=model, context=context)

    @classmethod
    def from_observations(cls, observations: Sequence[Observation], *, body: Body | None = None,
                          model: Model | None = None, crop: bool = True, context: Context | None = None) -> Avatar:
        """Makes an avatar from up to 8 observations of one person, as `from_photos`. crop: as in `from_observation`."""
        body = Body.load(context=context) if body is None else body
        model = Model.load(context=context) if model is None else model
        with ExitStack() as stack:
            used = list(_several(observations, "observations"))
            with using((model, Model), (body, Body), *((o, Observation) for o in used)):
                pass  # that they are what they should be, before anything is made of them
            if crop:
                used = [stack.enter_context(o.crop(model, body, context=context)) for o in used]
            with using((model, Model), (body, Body), *((o, Observation) for o in used)) as (weights, person, *pointers):
                made = make(context, "sherf_avatar_create_several", weights, person, len(used),
                            (c_void_p * len(used))(*pointers))
                return cls._made(made, body, context)

    @classmethod
    def load(cls, path: str | os.PathLike[str], body: Body | None = None, *, context: Context | None = None) -> Avatar:
        """Loads a file written by `save` or `sherf avatar`.

        body: the body it was made with; None means the open body. Raises `sherf.NoFile` or `sherf.BadFile`, and
        `sherf.Mismatch` for another body.
        """
        body = Body.load(context=context) if body is None else body
        with using((body, Body)) as (address,):
            return cls._made(make(context, "sherf_avatar_load", path_bytes(path), address), body, context)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the avatar as .safetensors. Raises `sherf.WriteFailed`."""
        with using((self, Avatar)) as (avatar,):
            context_or_default(self._context).run("sherf_avatar_save", avatar, path_bytes(path))

    @property
    def variant(self) -> int:
        """Which guess is used for the parts that no picture shows: 0 is the best guess, other numbers are seeds.

        `save` keeps it. Do not set it while another thread uses the avatar. Raises `sherf.Unsupported` if the avatar is
        baked.
        """
        with self._handle.use() as avatar:
            return int(LIBRARY.sherf_avatar_variant(avatar))

    @variant.setter
    def variant(self, seed: int) -> None:
        with using((self, Avatar)) as (avatar,):
            context_or_default(self._context).run("sherf_avatar_choose", avatar, whole(seed, 0, 2**64 - 1, "variant"))

    @property
    def pose(self) -> Pose:
        """The pose and shape of the (first) observation; a copy."""
        with self._handle.use() as avatar:
            return Pose.of_struct(LIBRARY.sherf_avatar_pose(avatar).contents)

    @property
    def camera(self) -> Camera:
        """The camera of the (first) observation; a copy."""
        with self._handle.use() as avatar:
            return Camera.of_struct(LIBRARY.sherf_avatar_camera(avatar).contents)

    def orbit(self, count: int = 1, pose: Pose | None = None, *, size: int | tuple[int, int] = 512,
              azimuth_rad: float = 0, elevation_rad: float = 0, distance_m: float = 0,
              fov_rad: float = 0) -> list[Camera]:
        """`count` cameras on a circle around the body in `pose`; None means the avatar's own pose.

        azimuth_rad, elevation_rad: of the first camera; azimuth 0 looks at the body's front. distance_m: 0 is far
        enough to show the whole body. fov_rad: vertical; 0: 30 degrees. size: pixels, one number or (width, height).
        """
        out = (CameraStruct * whole(count, 1, 100000, "count"))()
        o = OrbitOptions(real(azimuth_rad, "azimuth_rad"), real(elevation_rad, "elevation_rad"),
                         real(distance_m, "distance_m"), real(fov_rad, "fov_rad"), *size_of(size))
        shown = struct_of(self.pose if pose is None else pose, Pose)
        with using((self.body, Body)) as (body,):
            context_or_default(self._context).run("sherf_cameras_orbit", body, byref(shown), 1, byref(o), count, out)
        return [Camera.of_struct(camera) for camera in out]

    def render(self, pose: Pose | None = None, camera: Camera | None = None, *, size: int | tuple[int, int] = 512,
               azimuth_rad: float = 0, elevation_rad: float = 0, background: Color = (0, 0, 0), samples: int = 0,
               exact: bool = False, detail: bool = True) -> Frame:
        """Renders a frame.

        pose: None means the observation's. camera: None means one that shows the whole body, with `size` in pixels,
        `azimuth_rad` and `elevation_rad` as in `orbit`. background: red, green and blue in [0, 1].
        samples: depths per ray, 1 to 1024; 0: the model's, and more where its steps would be too long; -2: the model's.
        exact: queries the network at every point near the body, including those of little weight.
        detail: restores the detail that the picture shows and the network blurs.
        """
        shown = struct_of(self.pose if pose is None else pose, Pose)
        if camera is None:
            camera = self.orbit(1, pose, size=size, azimuth_rad=azimuth_rad, elevation_rad=elevation_rad)[0]
        seen, options = struct_of(camera, Camera), _render_options(background, samples, exact, detail)
        frame = FrameStruct()
        try:
            with using((self, Avatar), (self.body, Body)) as pointers:
                context_or_default(self._context).run("sherf_render", *pointers, byref(shown), byref(seen),
                                                      byref(options), byref(frame))
            return Frame(array_of(frame.color), array_of(frame.opacity), array_of(frame.depth), frame.points,
                         not any(options.background))
        finally:
            LIBRARY.sherf_frame_free(byref(frame))

    def animate(self, motion: Motion, output: str | os.PathLike[str], *, camera: str = "fixed",
                size: int | tuple[int, int] | None = None, azimuth_rad: float | None = None,
                elevation_rad: float | None = None, distance_m: float = 0, fov_rad: float = 0, turn_s: float = 0,
                transparent: bool = False, background: Color = (0, 0, 0), samples: int = 0, exact: bool = False,
                detail: bool = True) -> AnimateFacts:
        """Renders a motion to .mp4, .webm, .mov or .gif, or to a folder of pictures.

        camera: "fixed", "following", "orbiting" or "observation". Without azimuth and elevation it looks from where the
        picture was taken. distance_m: 0 is far enough to show the whole motion. fov_rad: vertical; 0: the
        observation's. size: pixels; None means 512 wide. turn_s: seconds per turn of an orbit; 0: 8. transparent:
        writes alpha; not for .mp4. The other arguments are those of `render`. If the call is cancelled, the file is
        completed with the frames so far. Raises `sherf.WriteFailed`.
        """
        o = self._animate_options(camera, size, azimuth_rad, elevation_rad, distance_m, fov_rad, turn_s)
        o.transparent, o.render = bool(transparent), _render_options(background, samples, exact, detail)
        result = AnimateResult()
        with using((self, Avatar), (self.body, Body), (motion, Motion)) as pointers:
            context_or_default(self._context).run("sherf_animate", *pointers, byref(o), path_bytes(output, "output"),
                                                  byref(result))
        return AnimateFacts(**fields_of(result))

    def frames(self, motion: Motion, *, camera: str = "fixed", size: int | tuple[int, int] | None = None,
               azimuth_rad: float | None = None, elevation_rad: float | None = None, distance_m: float = 0,
               fov_rad: float = 0, turn_s: float = 0, **options: Any) -> Iterator[Frame]:
        """Yields the frames of a motion one by one, seen by the cameras of `animate`. options: as for `render`."""
        o = self._animate_options(camera, size, azimuth_rad, elevation_rad, distance_m, fov_rad, turn_s)
        out = (CameraStruct * len(motion))()
        with using((self, Avatar), (self.body, Body), (motion, Motion)) as pointers:
            context_or_default(self._context).run("sherf_animate_cameras", *pointers, byref(o), out)
        for i, seen in enumerate(out):
            yield self.render(motion[i], Camera.of_struct(seen), **options)

    @staticmethod
    def _animate_options(camera: str, size: Any, azimuth_rad: float | None, elevation_rad: float | None,
                         distance_m: float, fov_rad: float, turn_s: float) -> AnimateOptions:
        """The library's struct of a camera path. Raises TypeError or ValueError."""
        width, height = (0, 0) if size is None else size_of(size)
        return AnimateOptions(choice(camera, CAMERA_PATHS, "camera"), width, height,
                              azimuth_rad is not None or elevation_rad is not None,
                              real(azimuth_rad or 0, "azimuth_rad"), real(elevation_rad or 0, "elevation_rad"),
                              real(distance_m, "distance_m"), real(fov_rad, "fov_rad"), real(turn_s, "turn_s"))

    def bake(self, *, resolution: int = 0, triangles: int = 0, texture_px: int = 0, detail: bool = True) -> Avatar:
        """A new avatar whose person is a skinned, textured surface. It renders in milliseconds without the network.

        It renders, animates, saves and loads like any avatar. Exact frames and exports need the avatar it was made
        from. resolution: cells along the body's longest side; 0: 256. triangles: 0: 40 000. texture_px: side in pixels,
        a multiple of 8; 0: 1024. detail: as for `render`, for the colours.
        """
        o = BakeOptions(_int(resolution, "resolution"), _int(triangles, "triangles"), _int(texture_px, "texture_px"),
                        1 if detail else -1)
        with using((self, Avatar), (self.body, Body)) as pointers:
            return self._made(make(self._context, "sherf_avatar_bake", *pointers, byref(o)), self.body, self._context)

    def export(self, path: str | os.PathLike[str], *, format: str | None = None, resolution: int = 0, level: float = 0,
               islands: float = 0, triangles: int = 0, texture_px: int = 0, splats: int = 0, pose: Pose | None = None,
               motion: Motion | None = None, lit: bool = False, up: str = "auto", detail: bool = True) -> ExportFacts:
        """Writes the person for other programs: .glb (rigged and textured), .obj, .ply, or Gaussian splats.

        format: "glb", "obj", "ply" or "splats"; None: by the file's name, where .ply means a mesh.
        resolution: cells along the body's longest side, 16 to 768; 0: 256.
        level: density of the surface, per metre; 0: the one whose silhouettes match the frames'.
        islands: components smaller than this share of the largest one's area are removed; 0: 0.02.
        triangles: 0: 50 000; negative: not reduced.
        texture_px: side of the texture, 64 to 4096; 0: 1024; negative: vertex colours.
        splats: 0: 100 000.
        pose: None means the T-pose. motion: the animation of a .glb. lit: light falls on a .glb's material; otherwise
            it shows its colours unchanged. up: the up axis of .obj and .ply. detail: as for `render`.

        Raises `sherf.BadArgument`, `sherf.WriteFailed`, and `sherf.Unsupported` if the avatar is baked.
        """
        o = ExportOptions(text_bytes(format, "format"), _int(resolution, "resolution"), real(level, "level"),
                          real(islands, "islands"), _int(triangles, "triangles"), _int(texture_px, "texture_px"),
                          _int(splats, "splats"))
        o.lit, o.up, o.detail = bool(lit), choice(up, UPS, "up"), 1 if detail else -1
        standing = None if pose is None else struct_of(pose, Pose)
        if standing is not None:
            o.pose = pointer(standing)
        exported = ExportedStruct()
        with using((self, Avatar), (self.body, Body), (motion, Motion)) as (avatar, body, o.motion):
            context_or_default(self._context).run("sherf_export", avatar, body, byref(o), path_bytes(path),
                                                  byref(exported))
        return ExportFacts(**fields_of(exported))


def _int(value: Any, what: str) -> int:
    """`value` as a C int. Raises TypeError or ValueError."""
    return whole(value, -(2**31), 2**31 - 1, what)
