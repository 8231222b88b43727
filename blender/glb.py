"""Checks that a .glb was written by `sherf export`, before Blender's importer reads it. Needs no Blender."""
import json
import os
import struct

from .motion import NAMES
from .program import Failure

JSON_MAX = 64 << 20


def json_of(path):
    """The JSON chunk of the .glb `path` as a dict. Raises Failure if the file is missing, damaged or no glTF 2.0."""
    try:
        with open(path, "rb") as f:
            head = f.read(20)
            if len(head) < 20 or head[:4] != b"glTF":
                raise Failure(f"{path}: not a .glb (it does not begin with glTF)")
            version, total, size, kind = struct.unpack("<IIII", head[4:])
            if version != 2 or kind != 0x4E4F534A:
                raise Failure(f"{path}: not a .glb of glTF 2.0")
            if total != os.fstat(f.fileno()).st_size:
                raise Failure(f"{path}: damaged, {total} bytes are announced and "
                              f"{os.fstat(f.fileno()).st_size} are there")
            if size > min(JSON_MAX, total - 20):
                raise Failure(f"{path}: damaged, its JSON is longer than the file")
            found = json.loads(f.read(size).decode("utf-8"))
    except OSError as error:
        raise Failure(f"{path}: {error.strerror}") from error
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise Failure(f"{path}: damaged, its JSON cannot be read") from error
    if not isinstance(found, dict):
        raise Failure(f"{path}: damaged, its JSON is no object")
    return found


def check(path):
    """Checks that `path` is a person written by `sherf export`: 24 joints with SMPL's names, and no references to other
    files. Returns its JSON as a dict, or raises Failure."""
    g = json_of(path)
    try:
        for part in g.get("buffers", []) + g.get("images", []):
            if "uri" in part:
                raise Failure(f"{path}: refers to another file; a .glb of sherf export does not")
        names = [g["nodes"][j]["name"] for j in g["skins"][0]["joints"]]
        meshes, skins = len(g["meshes"]), len(g["skins"])
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        raise Failure(f"{path}: no rigged person is in it; import a .glb that sherf export wrote") from error
    if names != list(NAMES) or meshes != 1 or skins != 1:
        raise Failure(f"{path}: not a person of sherf export (its joints are not SMPL's 24)")
    return g
