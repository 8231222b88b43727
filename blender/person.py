"""Imports a .glb of `sherf export` as a person: a collection with a rig, a mesh and one material."""
import contextlib
import os
import re

import bpy
import numpy as np

from . import glb, rig
from .program import Failure

KINDS = ("objects", "meshes", "armatures", "materials", "images", "actions", "collections", "textures", "node_groups",
         "cameras", "lights", "curves", "scenes", "worlds")


# ---- what was there before ----
def everything():
    """What the Blender file contains now, by kind, for `remove_new`."""
    return {kind: {x.as_pointer() for x in getattr(bpy.data, kind)} for kind in KINDS}


def remove_new(before, keep=()):
    """Removes everything that was added since `before`, except `keep`."""
    keep = {x.as_pointer() for x in keep}
    for kind in KINDS:
        data = getattr(bpy.data, kind)
        for thing in [x for x in data if x.as_pointer() not in before[kind] | keep]:
            data.remove(thing)


@contextlib.contextmanager
def old_numpy_names():
    """Defines names that Blender 3.4's importer uses and that NumPy 1.24, Debian's version, no longer has."""
    missing = [(n, t) for n, t in (("bool", bool), ("int", int), ("float", float), ("object", object))
               if n not in np.__dict__]
    for name, kind in missing:
        setattr(np, name, kind)
    try:
        yield
    finally:
        for name, _ in missing:
            delattr(np, name)


def gltf_options():
    """The importer options we want, limited to those that this Blender knows."""
    try:
        known = bpy.ops.import_scene.gltf.get_rna_type().properties.keys()
    except (KeyError, AttributeError) as error:
        raise Failure("Blender's glTF importer is off; turn on 'glTF 2.0 format' in Preferences > Add-ons") from error
    wanted = {"merge_vertices": True, "disable_bone_shape": True, "import_shading": "NORMALS",
              "guess_original_bind_pose": True}
    return {name: value for name, value in wanted.items() if name in known}


def read_glb(path):
    """Runs Blender's glTF importer. Raises Failure if it cannot read the file."""
    try:
        with old_numpy_names():
            done = bpy.ops.import_scene.gltf(filepath=path, **gltf_options())
    except RuntimeError as error:
        lines = [line for line in str(error).splitlines() if re.match(r"\w*Error: (?!Python: )", line)]
        said = lines[-1][:200] if lines else "the file is damaged"
        raise Failure(f"{path}: Blender's glTF importer cannot read it: {said}") from error
    if "FINISHED" not in done:
        raise Failure(f"{path}: Blender's glTF importer refuses it")


# ---- its looks ----
def socket(node, *names):
    """The node's input with the first of `names` that this Blender knows."""
    return next(node.inputs[n] for n in names if n in node.inputs)


def colour_source(tree, mesh, image):
    """Makes the node that supplies the colours: the texture or the vertex colours. Returns its colour output."""
    if image:
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = image
    else:
        node = tree.nodes.new("ShaderNodeVertexColor")
        colors = getattr(mesh, "color_attributes", None) or mesh.vertex_colors
        node.layer_name = colors[0].name if len(colors) else ""
    node.location = (-320, 280)
    tree.nodes.active = node
    return node.outputs["Color"]


def make_material(name, mesh, image, lit):
    """A Principled BSDF material. If not lit, it emits the photo's colours instead of reflecting light."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    color = colour_source(tree, mesh, image)
    shader.inputs["Roughness"].default_value = 0.9
    socket(shader, "Specular IOR Level", "Specular").default_value = 0.2 if lit else 0
    if lit:
        tree.links.new(color, shader.inputs["Base Color"])
    else:
        shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
        tree.links.new(color, socket(shader, "Emission Color", "Emission"))
        shader.inputs["Emission Strength"].default_value = 1
    return material


def image_of(mesh):
    """The mesh's texture, or None."""
    for material in mesh.materials:
        for node in material.node_tree.nodes if material and material.node_tree else ():
            if node.type == "TEX_IMAGE" and node.image:
                return node.image
    return None


def dress(body, name, lit):
    """Gives the mesh a material and texture with the person's name, and smooth shading. Returns both."""
    mesh, image = body.data, image_of(body.data)
    material = make_material(name, mesh, image, lit)
    if image:
        image.name = name
        if not image.packed_file:
            image.pack()
    mesh.materials.clear()
    mesh.materials.append(material)
    mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
    mesh.update()
    return material, image


# ---- into the scene ----
def object_mode(context):
    """Switches to object mode."""
    if context.object and context.object.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")


def layer_of(parent, collection):
    """The layer collection of `collection` below `parent`, or None."""
    if parent.collection == collection:
        return parent
    return next((found for child in parent.children for found in [layer_of(child, collection)] if found), None)


@contextlib.contextmanager
def into_collection(context, name):
    """A new collection that receives everything that is imported inside the block."""
    collection = bpy.data.collections.new(name)
    context.scene.collection.children.link(collection)
    before = context.view_layer.active_layer_collection
    context.view_layer.active_layer_collection = layer_of(context.view_layer.layer_collection, collection)
    try:
        yield collection
    finally:
        context.view_layer.active_layer_collection = before


def select(context, armature, body):
    """Selects the mesh and the rig and nothing else; the rig is active."""
    for thing in context.selected_objects:
        thing.select_set(False)
    for thing in (body, armature):
        thing.select_set(True)
    context.view_layer.objects.active = armature


def tidy(before, collection, path, name, lit):
    """Keeps the rig and the mesh that the importer made and removes the rest. Returns both."""
    new = [o for o in bpy.data.objects if o.as_pointer() not in before["objects"]]
    rigs = [o for o in new if rig.is_person(o)]
    bodies = [o for o in new if o.type == "MESH" and rigs and o.parent == rigs[0] and o.vertex_groups]
    if len(rigs) != 1 or len(bodies) != 1:
        raise Failure(f"{path}: no rigged person came out of it")
    armature, body = rigs[0], bodies[0]
    for thing in (armature, body):
        for other in list(thing.users_collection):
            other.objects.unlink(thing)
        collection.objects.link(thing)
    for bone in armature.pose.bones:
        bone.custom_shape = None
        bone.rotation_mode = "QUATERNION"
    material, image = dress(body, name, lit)
    armature.name = armature.data.name = name
    body.name = body.data.name = name + " mesh"
    action = rig.action_of(armature)
    if action:
        action.name = name + " motion"
    kept = (armature, armature.data, body, body.data, material, image, action, collection)
    remove_new(before, [x for x in kept if x])
    return armature, body


def stand(context, armature, body):
    """Puts the rest pose on the floor (z = 0 under the feet), and also the action or the current pose."""
    armature.rotation_mode = "XYZ"
    heights = np.empty(3 * len(body.data.vertices), np.float32)
    body.data.vertices.foreach_get("co", heights)
    rig.raise_rest(armature, body, -float(heights[2::3].min()))
    rig.remember_rest(armature)
    action = rig.action_of(armature)
    if action:
        rig.ground_action(armature, body, action)
    else:
        rig.ground_pose(armature, body)
    context.view_layer.update()


def import_glb(context, path, name, lit=True):
    """Imports the person and returns its armature. On Failure nothing is left in the Blender file."""
    glb.check(path)
    if not os.access(path, os.R_OK):
        raise Failure(f"{path}: cannot be read")
    object_mode(context)
    before = everything()
    try:
        with into_collection(context, name) as collection:
            read_glb(path)
            armature, body = tidy(before, collection, path, name, lit)
        stand(context, armature, body)
    except Exception as error:
        remove_new(before)
        if isinstance(error, Failure):
            raise
        raise Failure(f"{path}: cannot be imported: {error}") from error
    select(context, armature, body)
    return armature
