"""Renders a .glb in Blender: the person at some times of its animation, side by side, under a soft light.

    blender --background --factory-startup --python tools/blender_picture.py -- person.glb OUT.png [COUNT [HEIGHT]]
"""
import math, os, sys

import bpy
import numpy as np
from mathutils import Vector

for name in ("bool", "int", "float", "object"):  # Blender 3.4's importer uses names that NumPy 1.24 no longer has
    if name not in np.__dict__:
        setattr(np, name, {"bool": bool, "int": int, "float": float, "object": object}[name])

words = sys.argv[sys.argv.index("--") + 1:]
glb, out = os.path.abspath(words[0]), os.path.abspath(words[1])
count, height = int(words[2]) if len(words) > 2 else 4, int(words[3]) if len(words) > 3 else 480
scene = bpy.context.scene
for thing in list(bpy.data.objects):
    bpy.data.objects.remove(thing)
space = 1.35
for i in range(count):
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=glb)
    new = [o for o in bpy.data.objects if o not in before]
    armature = next(o for o in new if o.type == "ARMATURE")
    person = next(o for o in new if o.type == "MESH" and o.vertex_groups)
    for o in new:
        if o.type == "MESH" and o is not person:
            o.hide_render = True
    action = armature.animation_data.action if armature.animation_data else None
    if action:  # hold frame i of count
        first, last = action.frame_range
        at = first + (last - first) * i / max(count - 1, 1)
        for curve in action.fcurves:
            value = curve.evaluate(at)
            curve.keyframe_points.clear()
            curve.keyframe_points.insert(1, value)
    scene.frame_set(1)
    bpy.context.view_layer.update()
    corners = [person.matrix_world @ v.co for v in
               person.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices]
    low = [min(c[k] for c in corners) for k in range(3)]
    high = [max(c[k] for c in corners) for k in range(3)]
    armature.location += Vector((space * (i - (count - 1) / 2) - (low[0] + high[0]) / 2,
                                 -(low[1] + high[1]) / 2, -low[2]))
    armature.rotation_mode = "XYZ"
bpy.ops.mesh.primitive_plane_add(size=40)
floor = bpy.data.materials.new("floor")
floor.use_nodes = True
floor.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.8, 0.82, 1)
floor.node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 1
bpy.context.object.data.materials.append(floor)
bpy.ops.object.light_add(type="SUN", rotation=(0.7, 0.25, 0.5))
bpy.context.object.data.energy, bpy.context.object.data.angle = 2.2, 0.3
world = bpy.data.worlds.new("world")
scene.world = world
world.use_nodes = True
world.node_tree.nodes["Background"].inputs[0].default_value = (0.9, 0.93, 1, 1)
world.node_tree.nodes["Background"].inputs[1].default_value = 0.8
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
camera.data.lens = 70
reach = space * count * 0.5 + 0.2
width = int(height * 2 * reach / 2.1)
distance = 2 * reach * camera.data.lens / 36
camera.location = (0, -distance, 1.25)
camera.rotation_euler = (math.atan2(distance, 0.35), 0, 0)
scene.camera = camera
scene.render.engine = "CYCLES"
scene.cycles.samples = 24
scene.cycles.use_denoising = False
scene.view_settings.view_transform = "Standard"
scene.render.threads_mode, scene.render.threads = "FIXED", int(os.environ.get("OMP_NUM_THREADS", "2"))
scene.render.resolution_x, scene.render.resolution_y = width, height
scene.render.image_settings.file_format = "PNG"
scene.render.image_settings.color_mode = "RGB"
scene.render.filepath = out
bpy.ops.render.render(write_still=True)
