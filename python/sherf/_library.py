"""Finds and loads the shared library, and declares its structs and functions as in sherf.h."""

from __future__ import annotations

import ctypes
import os
from ctypes import (CDLL, CFUNCTYPE, POINTER, Structure, c_char_p, c_double, c_float, c_int, c_int64, c_size_t,
                    c_uint, c_uint32, c_uint64, c_void_p)
from pathlib import Path
from typing import Any

VERSION = "0.1.0"  # of the sherf.h from which the structs below are copied
SONAME = "libsherf.so.0"
_HERE = Path(__file__).resolve().parent

LOG_FUNCTION = CFUNCTYPE(None, c_void_p, c_int, c_char_p)
PROGRESS_FUNCTION = CFUNCTYPE(None, c_void_p, c_char_p, c_double, c_double)


class Options(Structure):
    """The C struct sherf_options."""

    _fields_ = [("threads", c_int), ("precision", c_int), ("log", LOG_FUNCTION), ("progress", PROGRESS_FUNCTION),
                ("user", c_void_p), ("device", c_int)]


class CameraStruct(Structure):
    """The C struct sherf_camera."""

    _fields_ = [("width_px", c_int), ("height_px", c_int), ("K", c_float * 9), ("R", c_float * 9), ("T_m", c_float * 3)]


class PoseStruct(Structure):
    """The C struct sherf_pose."""

    _fields_ = [("poses_rad", c_float * 72), ("shapes", c_float * 10), ("R", c_float * 9), ("Th_m", c_float * 3)]


class ImageStruct(Structure):
    """The C struct sherf_image."""

    _fields_ = [("width", c_int), ("height", c_int), ("channels", c_int), ("data", POINTER(c_float))]


class EstimateOptions(Structure):
    """The C struct sherf_estimate_options."""

    _fields_ = [("person", c_int), ("focal_px", c_double), ("mask", c_char_p)]


class EstimateFactsStruct(Structure):
    """The C struct sherf_estimate_facts."""

    _fields_ = [("people", c_int), ("person", c_int), ("warnings", c_uint), ("width_px", c_int), ("height_px", c_int),
                ("box_px", c_float * 4), ("person_px", c_double), ("focal_px", c_double), ("pitch_deg", c_double),
                ("lean_deg", c_double), ("landmarks_off", c_double), ("mask_covered", c_double),
                ("body_inside", c_double), ("find_ms", c_double), ("mask_ms", c_double), ("fit_ms", c_double)]


class ClipOptions(Structure):
    """The C struct sherf_clip_options."""

    _fields_ = [("person", c_int), ("focal_px", c_double), ("fps", c_double), ("smooth", c_double)]


class ClipFactsStruct(Structure):
    """The C struct sherf_clip_facts."""

    _fields_ = [("frames", c_int), ("fps", c_double), ("people", c_int), ("filled", c_int), ("filled_longest", c_int),
                ("repaired", c_int), ("left_out", c_int), ("poor", c_int), ("cuts", c_int), ("start_s", c_double),
                ("focal_px", c_double), ("pitch_rad", c_double), ("roll_rad", c_double), ("landmarks", c_double),
                ("shapes", c_float * 10), ("seconds", c_double * 3)]


class RenderOptions(Structure):
    """The C struct sherf_render_options."""

    _fields_ = [("background", c_float * 3), ("samples", c_int), ("exact", c_int), ("detail", c_int)]


class FrameStruct(Structure):
    """The C struct sherf_frame."""

    _fields_ = [("color", ImageStruct), ("opacity", ImageStruct), ("depth", ImageStruct), ("points", c_int64)]


class MotionOptions(Structure):
    """The C struct sherf_motion_options."""

    _fields_ = [("up", c_int), ("rotations", c_int), ("scale", c_double), ("source_fps", c_double), ("fps", c_double),
                ("fps_max", c_double), ("track", c_char_p), ("first", c_int), ("last", c_int), ("root", c_int),
                ("smooth_s", c_double), ("loop", c_int), ("start", POINTER(PoseStruct)), ("blend_s", c_double),
                ("body", c_void_p), ("shapes", POINTER(c_float)), ("their_shape", c_int), ("joints", c_char_p)]


class ExportOptions(Structure):
    """The C struct sherf_export_options."""

    _fields_ = [("format", c_char_p), ("resolution", c_int), ("level", c_double), ("islands", c_double),
                ("triangles", c_int), ("texture_px", c_int), ("splats", c_int), ("pose", POINTER(PoseStruct)),
                ("motion", c_void_p), ("lit", c_int), ("up", c_int), ("detail", c_int)]


class BakeOptions(Structure):
    """The C struct sherf_bake_options."""

    _fields_ = [("resolution", c_int), ("triangles", c_int), ("texture_px", c_int), ("detail", c_int)]


class ExportedStruct(Structure):
    """The C struct sherf_exported."""

    _fields_ = [("vertices", c_int64), ("triangles", c_int64), ("splats", c_int64), ("level", c_double),
                ("islands", c_int), ("charts", c_int), ("seconds", c_double * 4)]


class OrbitOptions(Structure):
    """The C struct sherf_orbit_options."""

    _fields_ = [("azimuth_rad", c_double), ("elevation_rad", c_double), ("distance_m", c_double),
                ("fov_rad", c_double), ("width_px", c_int), ("height_px", c_int)]


class AnimateOptions(Structure):
    """The C struct sherf_animate_options."""

    _fields_ = [("camera", c_int), ("width_px", c_int), ("height_px", c_int), ("aimed", c_int),
                ("azimuth_rad", c_double), ("elevation_rad", c_double), ("distance_m", c_double),
                ("fov_rad", c_double), ("turn_s", c_double), ("transparent", c_int), ("render", RenderOptions)]


class AnimateResult(Structure):
    """The C struct sherf_animate_result."""

    _fields_ = [("frames", c_int), ("frame_ms", c_double), ("points", c_double)]


# Each struct by its C name, for the test that compares them with sherf.h.
STRUCTS = {"sherf_options": Options, "sherf_camera": CameraStruct, "sherf_pose": PoseStruct,
           "sherf_image": ImageStruct, "sherf_estimate_options": EstimateOptions,
           "sherf_estimate_facts": EstimateFactsStruct, "sherf_clip_options": ClipOptions,
           "sherf_clip_facts": ClipFactsStruct, "sherf_render_options": RenderOptions, "sherf_frame": FrameStruct,
           "sherf_motion_options": MotionOptions, "sherf_export_options": ExportOptions,
           "sherf_bake_options": BakeOptions, "sherf_exported": ExportedStruct, "sherf_orbit_options": OrbitOptions,
           "sherf_animate_options": AnimateOptions, "sherf_animate_result": AnimateResult}

# Names of the enumerations' values, in the header's order.
PRECISIONS = ("auto", "fp32", "bf16")
DEVICES = ("auto", "cpu", "cuda")
UPS = ("auto", "y", "z", "-y")
ROTATIONS = ("auto", "axis-angle", "matrix", "wxyz", "xyzw", "6d-rows", "6d-columns")
ROOTS = ("kept", "dropped", "grounded")
CAMERA_PATHS = ("fixed", "following", "orbiting", "observation")
WARNINGS = ("from_behind", "cut_feet", "cut_head", "small", "hidden_arms", "poor", "mask_cut")

_OUT = POINTER(c_void_p)
_OBJECT = c_void_p
_PATH = c_char_p
_TEXT = POINTER(c_void_p)  # char **; free the text with sherf_free
_CAMERA, _POSE, _IMAGE = POINTER(CameraStruct), POINTER(PoseStruct), POINTER(ImageStruct)
_COUNT = POINTER(c_int)
_FLOATS = POINTER(c_float)

# Every function used here: its return type (int is a status) and its argument types.
FUNCTIONS: dict[str, tuple[Any, list[Any]]] = {
    "sherf_version": (c_char_p, []),
    "sherf_context_create": (c_int, [POINTER(Options), _OUT]),
    "sherf_context_free": (None, [_OBJECT]),
    "sherf_message": (c_char_p, [_OBJECT]),
    "sherf_cancel": (None, [_OBJECT]),
    "sherf_cancel_reset": (None, [_OBJECT]),
    "sherf_precision_used": (c_int, [_OBJECT]),
    "sherf_device_used": (c_int, [_OBJECT]),
    "sherf_device_find": (c_int, [c_int, c_char_p, c_size_t]),
    "sherf_free": (None, [c_void_p]),
    "sherf_image_free": (None, [_IMAGE]),
    "sherf_image_read": (c_int, [_OBJECT, _PATH, _IMAGE]),
    "sherf_image_write": (c_int, [_OBJECT, _PATH, _IMAGE]),
    "sherf_camera_orbit": (None, [_FLOATS, c_float, c_float, c_float, c_float, c_int, c_int, _CAMERA]),
    "sherf_pose_identity": (None, [_POSE]),
    "sherf_pose_canonical": (None, [_POSE]),
    "sherf_body_load": (c_int, [_OBJECT, _PATH, _OUT]),
    "sherf_body_free": (None, [_OBJECT]),
    "sherf_body_vertex_count": (c_int, [_OBJECT]),
    "sherf_body_face_count": (c_int, [_OBJECT]),
    "sherf_body_faces": (POINTER(c_uint32), [_OBJECT]),
    "sherf_body_pose": (c_int, [_OBJECT, _OBJECT, _POSE, _FLOATS, _FLOATS]),
    "sherf_poses_load": (c_int, [_OBJECT, _PATH, POINTER(_POSE), _COUNT]),
    "sherf_cameras_load": (c_int, [_OBJECT, _PATH, POINTER(_CAMERA), _COUNT]),
    "sherf_observation_load": (c_int, [_OBJECT, _PATH, _OUT]),
    "sherf_observation_create": (c_int, [_OBJECT, _IMAGE, _IMAGE, _CAMERA, _POSE, _OUT]),
    "sherf_observation_free": (None, [_OBJECT]),
    "sherf_observation_camera": (_CAMERA, [_OBJECT]),
    "sherf_observation_pose": (_POSE, [_OBJECT]),
    "sherf_observation_image": (_IMAGE, [_OBJECT]),
    "sherf_observation_crop": (c_int, [_OBJECT, _OBJECT, _OBJECT, _OBJECT, _OUT]),
    "sherf_estimator_load": (c_int, [_OBJECT, _PATH, _OUT]),
    "sherf_estimator_free": (None, [_OBJECT]),
    "sherf_estimate_photo": (c_int, [_OBJECT, _OBJECT, _OBJECT, _PATH, POINTER(EstimateOptions), _OUT]),
    "sherf_estimate_picture": (c_int, [_OBJECT, _OBJECT, _OBJECT, _IMAGE, _IMAGE, POINTER(EstimateOptions), _OUT]),
    "sherf_estimate_share_shape": (c_int, [_OBJECT, _OBJECT, c_int, _OUT]),
    "sherf_estimate_free": (None, [_OBJECT]),
    "sherf_estimate_image": (_IMAGE, [_OBJECT]),
    "sherf_estimate_mask": (_IMAGE, [_OBJECT]),
    "sherf_estimate_camera": (_CAMERA, [_OBJECT]),
    "sherf_estimate_pose": (_POSE, [_OBJECT]),
    "sherf_estimate_found": (POINTER(EstimateFactsStruct), [_OBJECT]),
    "sherf_estimate_observation": (c_int, [_OBJECT, _OBJECT, _OUT]),
    "sherf_estimate_save": (c_int, [_OBJECT, _OBJECT, _OBJECT, _PATH]),
    "sherf_estimate_overlay": (c_int, [_OBJECT, _OBJECT, _OBJECT, _PATH]),
    "sherf_estimate_clip": (c_int, [_OBJECT, _PATH, _OBJECT, _PATH, POINTER(ClipOptions), _PATH,
                                    POINTER(ClipFactsStruct)]),
    "sherf_model_load": (c_int, [_OBJECT, _PATH, _OUT]),
    "sherf_model_create": (c_int, [_OBJECT, c_char_p, c_uint64, _OUT]),
    "sherf_model_save": (c_int, [_OBJECT, _OBJECT, _PATH]),
    "sherf_model_free": (None, [_OBJECT]),
    "sherf_model_parameter_count": (c_int64, [_OBJECT]),
    "sherf_avatar_create": (c_int, [_OBJECT, _OBJECT, _OBJECT, _OBJECT, _OUT]),
    "sherf_avatar_create_several": (c_int, [_OBJECT, _OBJECT, _OBJECT, c_int, _OUT, _OUT]),
    "sherf_avatar_choose": (c_int, [_OBJECT, _OBJECT, c_uint64]),
    "sherf_avatar_variant": (c_uint64, [_OBJECT]),
    "sherf_avatar_save": (c_int, [_OBJECT, _OBJECT, _PATH]),
    "sherf_avatar_load": (c_int, [_OBJECT, _PATH, _OBJECT, _OUT]),
    "sherf_avatar_free": (None, [_OBJECT]),
    "sherf_avatar_pose": (_POSE, [_OBJECT]),
    "sherf_avatar_camera": (_CAMERA, [_OBJECT]),
    "sherf_render": (c_int, [_OBJECT, _OBJECT, _OBJECT, _POSE, _CAMERA, POINTER(RenderOptions), POINTER(FrameStruct)]),
    "sherf_frame_free": (None, [POINTER(FrameStruct)]),
    "sherf_frame_rgba": (c_int, [_OBJECT, POINTER(FrameStruct), _IMAGE]),
    "sherf_motion_load": (c_int, [_OBJECT, _PATH, POINTER(MotionOptions), _OUT]),
    "sherf_motion_free": (None, [_OBJECT]),
    "sherf_motion_frame_count": (c_int, [_OBJECT]),
    "sherf_motion_fps": (c_double, [_OBJECT]),
    "sherf_motion_pose": (None, [_OBJECT, c_int, _POSE]),
    "sherf_motion_pose_at": (None, [_OBJECT, c_double, _POSE]),
    "sherf_motion_description": (c_char_p, [_OBJECT]),
    "sherf_motion_save": (c_int, [_OBJECT, _OBJECT, _PATH]),
    "sherf_avatar_bake": (c_int, [_OBJECT, _OBJECT, _OBJECT, POINTER(BakeOptions), _OUT]),
    "sherf_export": (c_int, [_OBJECT, _OBJECT, _OBJECT, POINTER(ExportOptions), _PATH, POINTER(ExportedStruct)]),
    "sherf_cameras_orbit": (c_int, [_OBJECT, _OBJECT, _POSE, c_int, POINTER(OrbitOptions), c_int, _CAMERA]),
    "sherf_animate_cameras": (c_int, [_OBJECT, _OBJECT, _OBJECT, _OBJECT, POINTER(AnimateOptions), _CAMERA]),
    "sherf_animate": (c_int, [_OBJECT, _OBJECT, _OBJECT, _OBJECT, POINTER(AnimateOptions), _PATH,
                              POINTER(AnimateResult)]),
    "sherf_convert": (c_int, [_OBJECT, _PATH, _PATH, _TEXT]),
    "sherf_info": (c_int, [_OBJECT, _PATH, c_int, _TEXT]),
}


def _candidates() -> list[str]:
    """The library named by SHERF_LIBRARY, otherwise the one in the wheel, otherwise the system's."""
    named = os.environ.get("SHERF_LIBRARY")
    if named:
        return [named]
    inside = _HERE / "lib" / SONAME
    return [str(inside)] if inside.exists() else [SONAME]


def _looked(path: str) -> str:
    """Says where the library was looked for and what to do if it cannot be loaded."""
    if os.environ.get("SHERF_LIBRARY"):
        return ("SHERF_LIBRARY names it, so nothing else was looked at: name the libsherf.so.0 of a build or of "
                "Debian's package libsherf0 there, or unset it")
    if not (_HERE / "lib" / SONAME).exists():
        return (f"looked for {_HERE / 'lib' / SONAME}, as in a wheel, and in the system's folders of libraries: "
                f"install Debian's package libsherf0 or the wheel, or name the library in SHERF_LIBRARY")
    try:
        packages = (_HERE / "lib" / "needs.txt").read_text(encoding="utf-8").split()
    except OSError:
        return "install the wheel again: its list of packages is missing"
    return "it needs these packages of Debian 12: " + " ".join(packages)


def load() -> CDLL:
    """Loads the library and sets all prototypes. Raises ImportError, which says what is missing."""
    path = _candidates()[0]
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
        raise ImportError(f"sherf: {path} cannot be loaded ({error}); {_looked(path)}") from None
    try:
        for name, (result, arguments) in FUNCTIONS.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    except AttributeError:
        raise ImportError(f"sherf: {path} has no {name}: it is not the library of version {VERSION}") from None
    version = library.sherf_version().decode()
    if version != VERSION:
        raise ImportError(f"sherf: {path} is of version {version}, and this package is for {VERSION}")
    return library


LIBRARY = load()


def assets_folders() -> list[Path]:
    """The folders in which body, model and networks are looked for, in this order."""
    named = os.environ.get("SHERF_ASSETS")
    inside = [_HERE / "assets", Path("/usr/local/share/sherf"), Path("/usr/share/sherf")]
    return ([Path(named)] if named else []) + inside
