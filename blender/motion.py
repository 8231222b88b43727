"""Reads motions written by the program (BVH with SMPL's joints) and computes a rig's rotations from them.

Quaternions are (w, x, y, z). In the program's axes y is up, z is the front and x is left; in Blender's z is up, -y is
the front and x is left. Needs no Blender."""
import math

from .program import Failure

NAMES = ("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
         "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
         "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand")
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
FRAMES_MAX = 1000000
IDENTITY = (1.0, 0.0, 0.0, 0.0)


# ---- quaternions ----
def multiply(a, b):
    """The rotation that applies first b, then a."""
    return (a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0])


def inverse(q):
    """The inverse of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def about(axis, radians):
    """The rotation about axis 0, 1 or 2 (x, y, z)."""
    q = [math.cos(radians / 2), 0.0, 0.0, 0.0]
    q[1 + axis] = math.sin(radians / 2)
    return tuple(q)


def rotate(q, v):
    """The vector v turned by q."""
    return multiply(multiply(q, (0.0, v[0], v[1], v[2])), inverse(q))[1:]


def nearer(q, before):
    """q or -q, whichever is nearer to `before`. Curves between keys then take the shorter path."""
    along = sum(a * b for a, b in zip(q, before))
    return tuple(-x for x in q) if along < 0 else q


def to_blender(v):
    """A point or direction (3) from the program's axes to Blender's."""
    return (v[0], -v[2], v[1])


def turn_to_blender(q):
    """A rotation from the program's axes to Blender's."""
    return (q[0], q[1], -q[3], q[2])


# ---- BVH ----
class Clip:
    """A motion of SMPL's 24 joints, in SMPL's order.

    turns[frame][joint]: quaternion relative to the parent. pelvis[frame]: position (3) in metres. offsets[joint]:
    vector (3) from the parent at rest, in metres. fps: frames per second."""

    def __init__(self, offsets, fps, pelvis, turns):
        self.offsets, self.fps, self.pelvis, self.turns = offsets, fps, pelvis, turns

    def joints(self, frame):
        """The positions of the 24 joints in a frame, in metres and the program's axes."""
        at, turned = [], []
        for j, parent in enumerate(PARENTS):
            if parent < 0:
                at.append(tuple(self.pelvis[frame]))
                turned.append(self.turns[frame][j])
                continue
            step = rotate(turned[parent], self.offsets[j])
            at.append(tuple(at[parent][k] + step[k] for k in range(3)))
            turned.append(multiply(turned[parent], self.turns[frame][j]))
        return at


def joint_of(name):
    """SMPL's index of a BVH joint: L_Hip is left_hip. Raises Failure for other names."""
    name = name.lower()
    for short, side in (("l_", "left_"), ("r_", "right_")):
        if name.startswith(short):
            name = side + name[2:]
    if name not in NAMES:
        raise Failure(f"the motion has a joint {name[:40]}, which is none of SMPL's")
    return NAMES.index(name)


class _Words:
    """The words of a BVH text, read one after the other."""

    def __init__(self, text):
        self.words, self.at = text.split(), 0

    def take(self, wanted=None):
        """The next word, which must be `wanted` if that is given. Raises Failure."""
        if self.at >= len(self.words):
            raise Failure("the motion ends too early")
        word = self.words[self.at]
        if wanted and word != wanted:
            raise Failure(f"the motion has '{word[:40]}' where {wanted} should be")
        self.at += 1
        return word

    def number(self):
        """The next word as a finite number. Raises Failure."""
        word = self.take()
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise Failure(f"the motion has '{word[:40]}' where a number should be")
        return value

    def peek(self):
        """The next word without taking it; "" at the end."""
        return self.words[self.at] if self.at < len(self.words) else ""


def _channels(w):
    """[(kind, axis)] of a joint: kind is "position" or "rotation", axis 0, 1 or 2."""
    count, found = int(w.number()), []
    for _ in range(min(max(count, 0), 6)):
        word = w.take()
        if word[:1] not in "XYZ" or word[1:] not in ("position", "rotation"):
            raise Failure(f"the motion has a channel {word[:40]}")
        found.append((word[1:], "XYZ".index(word[0])))
    return found


def _hierarchy(w):
    """[(joint, parent, offset in metres, channels)] in the order of the file; the root's parent is -1."""
    found, open_joints = [], []
    w.take("HIERARCHY")
    while w.peek() != "MOTION":
        word = w.take()
        if word == "}":
            if not open_joints:
                raise Failure("the motion has a } too many")
            open_joints.pop()
        elif word == "End":
            for wanted in ("Site", "{", "OFFSET"):
                w.take(wanted)
            for _ in range(3):
                w.number()
            w.take("}")
        elif word in ("ROOT", "JOINT"):
            joint = joint_of(w.take())
            w.take("{")
            w.take("OFFSET")
            offset = tuple(0.01 * w.number() for _ in range(3))
            w.take("CHANNELS")
            found.append((joint, open_joints[-1] if open_joints else -1, offset, _channels(w)))
            open_joints.append(joint)
        else:
            raise Failure(f"the motion has '{word[:40]}' where a joint should be")
    return found


def bvh_read(text):
    """The Clip of a text written by `sherf animate --bvh`: SMPL's joints, centimetres, y up. Raises Failure."""
    w = _Words(text)
    joints = _hierarchy(w)
    if sorted(j[0] for j in joints) != list(range(24)) or any(PARENTS[j[0]] != j[1] for j in joints):
        raise Failure("the motion's joints are not SMPL's 24")
    for wanted in ("MOTION", "Frames:"):
        w.take(wanted)
    frames = int(w.number())
    for wanted in ("Frame", "Time:"):
        w.take(wanted)
    seconds = w.number()
    if not 1 <= frames <= FRAMES_MAX or not 1e-6 < seconds < 1e6:
        raise Failure("the motion has no frames")
    offsets = [(0.0, 0.0, 0.0)] * 24
    for joint, _, offset, _ in joints:
        offsets[joint] = offset
    pelvis, turns = [], []
    for _ in range(frames):
        place, turned = [0.0, 0.0, 0.0], [IDENTITY] * 24
        for joint, parent, _, channels in joints:
            q = IDENTITY
            for kind, axis in channels:
                value = w.number()
                if kind == "rotation":
                    q = multiply(q, about(axis, math.radians(value)))
                elif parent < 0:
                    place[axis] = 0.01 * value
            turned[joint] = q
        pelvis.append(tuple(place))
        turns.append(turned)
    return Clip(offsets, 1 / seconds, pelvis, turns)


# ---- onto a rig ----
def legs(joints):
    """The mean leg length, thigh plus shin, of joint positions."""
    def far(a, b):
        return math.dist(joints[a], joints[b])
    return (far(1, 4) + far(4, 7) + far(2, 5) + far(5, 8)) / 2


def fit_legs(clip, rig_legs):
    """Scales the pelvis path of `clip` if its legs differ in length from `rig_legs` (metres). Returns the factor."""
    rest = []
    for j, parent in enumerate(PARENTS):
        rest.append(tuple((rest[parent][k] if parent >= 0 else 0) + clip.offsets[j][k] for k in range(3)))
    own = legs(rest)
    factor = rig_legs / own if own > 0 else 1.0
    if abs(factor - 1) < 2e-3:
        return 1.0
    clip.pelvis = [tuple(factor * x for x in p) for p in clip.pelvis]
    return factor


def heading(q):
    """The angle about y, in radians, in which a body with root rotation q faces; 0 is z. For a lying body the left side
    gives the angle."""
    for axis, back in (((0, 0, 1), 0.0), ((1, 0, 0), math.pi / 2)):
        x, y, z = rotate(q, axis)
        if abs(y) < 0.8:
            return math.atan2(x, z) - back
    return 0.0


def place_here(clip):
    """Turns and moves the motion so that it begins at the origin, facing the front. Heights stay the same."""
    turn = about(1, -heading(clip.turns[0][0]))
    x, _, z = clip.pelvis[0]
    clip.pelvis = [rotate(turn, (p[0] - x, p[1], p[2] - z)) for p in clip.pelvis]
    for frame in clip.turns:
        frame[0] = multiply(turn, frame[0])


def a_pose(degrees=45.0):
    """The 24 joint rotations of an A-pose: arms lowered in the plane of the body."""
    turns = [IDENTITY] * 24
    turns[16], turns[17] = about(2, -math.radians(degrees)), about(2, math.radians(degrees))
    return turns


def bone_directions(turns, t_rest):
    """The bones' orientations in Blender's axes. turns: joint rotations in SMPL's axes. t_rest: orientations in the
    T-pose."""
    turned = []
    for j, parent in enumerate(PARENTS):
        own = turn_to_blender(turns[j])
        turned.append(multiply(turned[parent], own) if parent >= 0 else own)
    return [multiply(turned[j], t_rest[j]) for j in range(24)]


def bone_turns(turns, t_rest, rest):
    """The bones' own rotations (Blender's rotation_quaternion) for joint rotations `turns` in SMPL's axes. t_rest: each
    bone's orientation in the T-pose. rest: its orientation in the rig's rest pose, which may be a different one."""
    stand, out = bone_directions(turns, t_rest), []
    for j, parent in enumerate(PARENTS):
        want = stand[j]
        if parent >= 0:  # remove the parent's part
            want = multiply(rest[parent], multiply(inverse(stand[parent]), want))
        out.append(multiply(inverse(rest[j]), want))
    return out
