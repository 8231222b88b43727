"""Compares a .glb in Blender with frames of `sherf render`: silhouettes (intersection over union) and colours.

    blender --background --factory-startup --python tools/blender_check.py -- \
        person.glb cameras.json FRAMES [OUTPUT]

FRAMES holds what `sherf render --poses P.npz --cameras cameras.json --every --background transparent -o FRAMES`
wrote: frame 0000.png is the first pose from the first camera, then comes the first pose from the second camera. The
.glb was exported with `--motion P.npz`, so its animation has the same poses. OUTPUT: a folder for Blender's pictures.
docs/export.md has the whole recipe.
"""
import json, math, os, sys, tempfile

import bpy
import numpy as np
from mathutils import Matrix

for name in ("bool", "int", "float", "object"):  # Blender 3.4's importer uses names that NumPy 1.24 no longer has
    if name not in np.__dict__:
        setattr(np, name, {"bool": bool, "int": int, "float": float, "object": object}[name])


def camera_of(k):
    """Makes a Blender camera from K, R, T with OpenCV's axes. glTF's y is Blender's z."""
    width, height = int(k["width"]), int(k["height"])
    K, R, T = (np.array(k[name], float) for name in "KRT")
    K, R, T = K.reshape(3, 3), R.reshape(3, 3), T.reshape(3)
    to_blender = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
    world = np.eye(4)
    world[:3, :3] = to_blender @ R.T @ np.diag([1, -1, -1])
    world[:3, 3] = to_blender @ (-R.T @ T)
    data = bpy.data.cameras.new("sherf")
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = 36
    data.lens = K[0, 0] * 36 / width
    data.shift_x = -(K[0, 2] - (width - 1) / 2) / width
    data.shift_y = (K[1, 2] - (height - 1) / 2) / width
    data.clip_start, data.clip_end = 0.01, 1000
    camera = bpy.data.objects.new("sherf", data)
    camera.matrix_world = Matrix(world.tolist())
    bpy.context.scene.collection.objects.link(camera)
    return camera, width, height


def picture(path):
    """The file's pixels, H x W x 4, in [0, 1], with the top row first."""
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "Non-Color"
    values = np.array(image.pixels[:], np.float32).reshape(image.size[1], image.size[0], 4)[::-1]
    bpy.data.images.remove(image)
    return values


def main():
    """Imports, renders and compares, as the command line says."""
    words = sys.argv[sys.argv.index("--") + 1:]
    glb, cameras, frames = words[:3]
    output = words[3] if len(words) > 3 else tempfile.mkdtemp()
    os.makedirs(output, exist_ok=True)
    scene = bpy.context.scene
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    bpy.ops.import_scene.gltf(filepath=os.path.abspath(glb))
    meshes = [o for o in bpy.data.objects if o.type == "MESH" and o.vertex_groups]
    bones = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    print(f"imported: {len(meshes)} skinned mesh, {len(meshes[0].data.vertices)} vertices, "
          f"{len(bones[0].data.bones)} bones")
    for o in bpy.data.objects:  # remove the importer's bone shapes
        if o.type == "MESH" and o not in meshes:
            o.hide_render = True
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 8
    scene.cycles.use_denoising = False
    scene.cycles.filter_width = 0.01
    scene.render.threads_mode = "FIXED"
    scene.render.threads = int(os.environ.get("OMP_NUM_THREADS", "2"))
    scene.render.film_transparent = True
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    scene.view_settings.view_transform = "Standard"
    scene.render.use_persistent_data = True
    listed = [camera_of(k) for k in json.load(open(cameras))["cameras"]]
    names = sorted(n for n in os.listdir(frames) if n.endswith(".png"))
    poses = len(names) // len(listed)
    actions = [a for a in bpy.data.actions]
    first, last = (actions[0].frame_range if actions else (0, 0))
    overlaps, noises = [], []
    for pose in range(poses):
        at = first + (last - first) * pose / max(poses - 1, 1)
        scene.frame_set(int(math.floor(at)), subframe=at - math.floor(at))
        for view, (camera, width, height) in enumerate(listed):
            name = names[pose * len(listed) + view]
            scene.camera = camera
            scene.render.resolution_x, scene.render.resolution_y = width, height
            scene.render.resolution_percentage = 100
            scene.render.filepath = os.path.join(output, name)
            bpy.ops.render.render(write_still=True)
            own, theirs = picture(scene.render.filepath), picture(os.path.join(frames, name))
            a, b = own[..., 3] > 0.5, theirs[..., 3] > 0.5
            overlap = (a & b).sum() / max((a | b).sum(), 1)
            both = a & b
            error = ((own[..., :3] - theirs[..., :3])[both] ** 2).mean() if both.any() else 1
            # over black, over all pixels, as scores are computed
            flat = lambda p: p[..., :3] * p[..., 3:]
            whole = ((flat(own) - flat(theirs)) ** 2).mean()
            overlaps.append(overlap)
            noises.append(-10 * math.log10(max(error, 1e-9)))
            print(f"pose {pose} view {view}: overlap {overlap:.4f}, colours {noises[-1]:.1f} dB inside, "
                  f"{-10 * math.log10(max(whole, 1e-9)):.1f} dB in the picture", flush=True)
    print(f"least overlap {min(overlaps):.4f}, mean {np.mean(overlaps):.4f}; "
          f"least colours {min(noises):.1f} dB, first view {noises[0]:.1f} dB")
    sys.exit(0 if min(overlaps) >= 0.93 and noises[0] >= 20 else 1)


main()
