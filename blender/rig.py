"""A person's rig: applies motions to its bones, changes its rest pose and puts its feet on the floor."""
import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from . import motion
from .motion import NAMES, PARENTS
from .program import Failure

REST = "sherf_rest"      # bone property: its orientation in the T-pose, in the rig's space
AVATAR = "sherf_avatar"  # armature property: the avatar file it was made from
GROUND_FRAMES = 120      # frames examined when a motion is put on the floor
GROUND_SHARE = 10        # percent of these frames that may be below the floor


def is_person(thing):
    """Whether an object is an armature with SMPL's 24 joints."""
    return bool(thing and thing.type == "ARMATURE" and all(n in thing.data.bones for n in NAMES))


def find(context):
    """The rig of the active person, whether its rig or its mesh is active; None if there is none."""
    thing = context.active_object
    for candidate in (thing, thing.parent if thing else None, thing.find_armature() if thing else None):
        if is_person(candidate):
            return candidate
    return None


def bodies_of(armature):
    """The meshes that the armature deforms."""
    return [o for o in bpy.data.objects if o.type == "MESH" and o.find_armature() == armature]


# ---- rest poses ----
def remember_rest(armature):
    """Records the current rest pose as the T-pose."""
    for name in NAMES:
        bone = armature.data.bones[name]
        bone[REST] = list(bone.matrix_local.to_quaternion())


def rests(armature):
    """The bones' orientations in the T-pose and in the current rest pose, as quaternions."""
    now = [tuple(armature.data.bones[name].matrix_local.to_quaternion()) for name in NAMES]
    kept = [armature.data.bones[name].get(REST) for name in NAMES]
    return [tuple(k) if k is not None and len(k) == 4 else n for k, n in zip(kept, now)], now


def rest_matrices(armature):
    """The bones' rest matrices (4 x 4) in the rig's space, in SMPL's order."""
    return [armature.data.bones[name].matrix_local.copy() for name in NAMES]


def locals_of(matrices):
    """The matrices relative to their parents'."""
    return [matrices[PARENTS[j]].inverted() @ m if PARENTS[j] >= 0 else m for j, m in enumerate(matrices)]


def raise_rest(armature, body, height):
    """Moves the rest pose of rig and mesh up by `height` metres."""
    lift = Matrix.Translation((0, 0, height))
    armature.data.transform(lift)
    body.data.transform(lift)
    body.data.update()


def posed(armature, local):
    """The bones' matrices in the rig's space. local[j]: bone j's own matrix relative to rest."""
    out = []
    for j, step in enumerate(locals_of(rest_matrices(armature))):
        out.append((out[PARENTS[j]] if PARENTS[j] >= 0 else Matrix.Identity(4)) @ step @ local[j])
    return out


# ---- actions ----
def action_of(armature):
    """The armature's action, or None."""
    return armature.animation_data.action if armature.animation_data else None


def curves_of(armature, action):
    """The action's F-curves."""
    if hasattr(action, "fcurves"):
        return action.fcurves
    slot = armature.animation_data.action_slot  # Blender 5: curves are in layers
    bags = [strip.channelbag(slot) for layer in action.layers for strip in layer.strips]
    return next(bag.fcurves for bag in bags if bag)


def path_of(name, what):
    """The data path of a bone's property."""
    return f'pose.bones["{name}"].{what}'


def group_of(armature, action, name, what):
    """The F-curves of a bone's location or rotation, or None if any is missing."""
    curves = curves_of(armature, action)
    found = [curves.find(path_of(name, what), index=i) for i in range(4 if what == "rotation_quaternion" else 3)]
    return found if all(found) else None


def actions_of(armature):
    """The armature's actions: the active one and those of its NLA tracks."""
    data = armature.animation_data
    if not data:
        return []
    found = [data.action] + [strip.action for track in data.nla_tracks for strip in track.strips]
    return list({a.name: a for a in found if a}.values())


def action_locals(armature, action, frame):
    """The bones' own matrices (4 x 4) at a frame of an action."""
    out = []
    for name in NAMES:
        place = group_of(armature, action, name, "location")
        turn = group_of(armature, action, name, "rotation_quaternion")
        at = Vector([c.evaluate(frame) for c in place]) if place else Vector((0, 0, 0))
        q = Quaternion([c.evaluate(frame) for c in turn]).normalized() if turn else Quaternion()
        out.append(Matrix.Translation(at) @ q.to_matrix().to_4x4())
    return out


def fill_curve(curve, frames, values):
    """Sets a curve's keys, with linear interpolation."""
    points = curve.keyframe_points
    points.add(len(frames) - len(points))
    points.foreach_set("co", np.stack([frames, values], 1).astype(np.float32).ravel())
    points.foreach_set("interpolation", np.ones(len(frames), np.int32))  # linear
    curve.update()


def keep_action(armature):
    """Detaches the armature's action but keeps it in the Blender file, so that it can be used again."""
    data = armature.animation_data_create()
    if data.action:
        data.action.use_fake_user = True
        data.action = None


def write_action(armature, name, frames, places, turns):
    """A new action with pelvis locations F x 3 and rotations F x 24 x 4, all in the bones' own axes."""
    keep_action(armature)
    for bone in NAMES:
        pose_bone = armature.pose.bones[bone]
        pose_bone.rotation_mode = "QUATERNION"
        for what in ("location", "rotation_quaternion") if bone == NAMES[0] else ("rotation_quaternion",):
            pose_bone.keyframe_insert(what, frame=frames[0], group=bone)
    action = action_of(armature)
    action.name = name
    action.use_fake_user = True
    for j, bone in enumerate(NAMES):
        for i, curve in enumerate(group_of(armature, action, bone, "rotation_quaternion")):
            fill_curve(curve, frames, turns[:, j, i])
    for i, curve in enumerate(group_of(armature, action, NAMES[0], "location")):
        fill_curve(curve, frames, places[:, i])
    return action


# ---- on the floor ----
def weights_of(body):
    """The mesh's skin weights, V x 24; every row with weights sums to 1."""
    index = {body.vertex_groups[n].index: j for j, n in enumerate(NAMES) if n in body.vertex_groups}
    out = np.zeros((len(body.data.vertices), 24), np.float32)
    for v in body.data.vertices:
        for g in v.groups:
            if g.group in index:
                out[v.index, index[g.group]] = g.weight
    return out / np.maximum(out.sum(1, keepdims=True), 1e-9)


def points_of(body):
    """The mesh's vertices in homogeneous coordinates, V x 4."""
    out = np.empty(3 * len(body.data.vertices), np.float32)
    body.data.vertices.foreach_get("co", out)
    return np.concatenate([out.reshape(-1, 3), np.ones((len(body.data.vertices), 1), np.float32)], 1)


def moves(armature, stand):
    """The transformations from rest to the bone matrices `stand`, 24 x 4 x 4."""
    rest = rest_matrices(armature)
    return np.array([np.array(m @ r.inverted()) for m, r in zip(stand, rest)], np.float64)


def lowest(points, weights, matrices):
    """The lowest z of the skinned vertices, in metres."""
    return float(((points @ matrices[:, 2, :].T) * weights).sum(1).min())


def raise_action(armature, action, height):
    """Moves the pelvis up by `height` metres throughout an action."""
    curves = group_of(armature, action, NAMES[0], "location")
    step = rest_matrices(armature)[0].to_3x3().inverted() @ Vector((0, 0, height))
    for curve, more in zip(curves or (), step):
        for point in curve.keyframe_points:
            point.co[1] += more
            point.handle_left[1] += more
            point.handle_right[1] += more
        curve.update()


def ground_action(armature, body, action):
    """Puts a motion on the floor: nine of ten frames are on the floor or above it."""
    first, last = action.frame_range
    points, weights = points_of(body), weights_of(body)
    frames = np.linspace(first, last, min(GROUND_FRAMES, int(last - first) + 1))
    heights = [lowest(points, weights, moves(armature, posed(armature, action_locals(armature, action, float(f)))))
               for f in frames]
    raise_action(armature, action, -float(np.percentile(heights, GROUND_SHARE)))


def ground_pose(armature, body):
    """Puts the current pose on the floor, above the origin."""
    local = [armature.pose.bones[n].matrix_basis.copy() for n in NAMES]
    stand = posed(armature, local)
    down = lowest(points_of(body), weights_of(body), moves(armature, stand))
    rest = rest_matrices(armature)
    step = rest[0].translation - stand[0].translation
    step.z = -down
    if step.length > 1e-6:
        armature.pose.bones[NAMES[0]].location += rest[0].to_3x3().inverted() @ step


# ---- a motion onto the rig ----
def put_motion(context, armature, clip, name, here=True, first_frame=1, scene_range=True):
    """Makes a Clip the armature's action, with a key per frame. Returns the action and the scale of the steps."""
    heads = [armature.data.bones[n].head_local for n in NAMES]
    factor = motion.fit_legs(clip, motion.legs([tuple(h) for h in heads]))
    if here:
        motion.place_here(clip)
    t_rest, rest = rests(armature)
    turns = np.array([motion.bone_turns(frame, t_rest, rest) for frame in clip.turns])
    for f in range(1, len(turns)):
        turns[f] *= np.where((turns[f] * turns[f - 1]).sum(1, keepdims=True) < 0, -1.0, 1.0)
    own = armature.data.bones[NAMES[0]].matrix_local.inverted()
    places = np.array([own @ Vector(motion.to_blender(p)) for p in clip.pelvis])
    rate = context.scene.render.fps / context.scene.render.fps_base
    frames = first_frame + np.arange(len(turns)) * rate / clip.fps
    action = write_action(armature, name, frames, places, turns)
    bodies = bodies_of(armature)
    if here and bodies:
        ground_action(armature, bodies[0], action)
    if scene_range:
        context.scene.frame_start, context.scene.frame_end = first_frame, max(first_frame, int(frames[-1] + 0.5))
        context.scene.frame_set(first_frame)
    return action, factor


# ---- another rest pose ----
def turn_keys(armature, action, changes):
    """Applies the change of each bone's rest pose to every key of its rotation."""
    for name, change in zip(NAMES, changes):
        curves = group_of(armature, action, name, "rotation_quaternion")
        if not curves:
            continue
        frames = sorted({p.co[0] for c in curves for p in c.keyframe_points})
        values = [change @ Quaternion([c.evaluate(f) for c in curves]) for f in frames]
        for i, curve in enumerate(curves):
            fill_curve(curve, np.array(frames), np.array([v[i] for v in values]))


def new_rest(armature, turns):
    """The bones' matrices in a rest pose with joint rotations `turns` in SMPL's axes. The pelvis keeps its position."""
    t_rest, rest = rests(armature)
    own = motion.bone_turns(turns, t_rest, rest)
    return posed(armature, [Quaternion(q).to_matrix().to_4x4() for q in own])


def bend(body, armature, stand):
    """Moves the mesh's vertices as the rig does for the bone matrices `stand`. Going back undoes it exactly."""
    points, weights = points_of(body), weights_of(body)
    away = armature.get("sherf_rest_pose", "T") == "T"
    way = moves(armature, stand) if away else np.linalg.inv(moves(armature, stand))
    blended = np.einsum("vj,jab->vab", weights, way)
    blended += (1 - weights.sum(1))[:, None, None] * np.eye(4)  # vertices without weights stay
    points = blended @ points[:, :, None] if away else np.linalg.solve(blended, points[:, :, None])
    body.data.vertices.foreach_set("co", np.ascontiguousarray(points[:, :3, 0], np.float32).ravel())
    body.data.update()


def set_rest(context, armature, kind):
    """Makes a T or an A (`kind`) the rest pose of rig and mesh. Actions and the current pose look as before."""
    if armature.get("sherf_rest_pose", "T") == kind:
        return
    if armature.library or armature.data.library or armature.data.users > 1:
        raise Failure(f"{armature.name}: its rig is linked or shared; make it single-user first")
    t_rest, _ = rests(armature)
    for name, q in zip(NAMES, t_rest):
        armature.data.bones[name][REST] = list(q)
    stand = new_rest(armature, motion.a_pose() if kind == "A" else [motion.IDENTITY] * 24)
    before = locals_of(rest_matrices(armature))
    for body in bodies_of(armature):
        bend(body, armature, stand)
    set_bones(context, armature, stand)
    after = locals_of(rest_matrices(armature))
    changes = [(a.to_quaternion().inverted() @ b.to_quaternion()) for a, b in zip(after, before)]
    for action in actions_of(armature):
        turn_keys(armature, action, changes)
    for name, change in zip(NAMES, changes):
        bone = armature.pose.bones[name]
        bone.rotation_mode = "QUATERNION"
        bone.rotation_quaternion = change @ bone.rotation_quaternion
    armature["sherf_rest_pose"] = kind
    context.view_layer.update()


def set_bones(context, armature, matrices):
    """Sets the bones' rest matrices (edit mode), in the rig's space."""
    mode = armature.mode
    context.view_layer.objects.active = armature
    if mode != "EDIT":
        bpy.ops.object.mode_set(mode="EDIT")
    mirror, armature.data.use_mirror_x = armature.data.use_mirror_x, False
    for name, matrix in zip(NAMES, matrices):
        armature.data.edit_bones[name].matrix = matrix
    armature.data.use_mirror_x = mirror
    bpy.ops.object.mode_set(mode=mode if mode != "EDIT" else "OBJECT")
