"""The operators behind the menu and the panel: import (photo, avatar or .glb), motion and rest pose. The program
runs in the background; Esc cancels it."""
import os
import shutil
import time

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from . import motion, person, program, rig
from .program import Failure, Job

PHOTO_GLOB = ";".join("*" + e for e in program.PHOTOS)
IMPORT_GLOB = "*.safetensors;*.glb;" + PHOTO_GLOB
MOTION_GLOB = "*.npz;*.npy;*.pkl;*.pickle;*.pt;*.pth;*.json;*.bvh;*.fbx;*.glb;*.gltf;" + ";".join(
    "*" + e for e in program.VIDEOS)


def preferences(context):
    """The add-on's preferences, where the user chooses program and body."""
    return context.preferences.addons[__package__].preferences


def the_program(context):
    """The path of the program to call. Raises Failure if there is none."""
    chosen = preferences(context).program
    return program.find_program(bpy.path.abspath(chosen) if chosen else "")


def the_body(context):
    """The body model chosen in the preferences; "" for the open body."""
    body = preferences(context).body
    return bpy.path.abspath(body) if body else ""


def file_of(path):
    """The absolute path of what the user chose; // begins beside the Blender file."""
    return os.path.abspath(bpy.path.abspath(path))


def scene_fps(context):
    """The scene's frames per second."""
    return context.scene.render.fps / context.scene.render.fps_base


# ---- operators that wait for the program ----
class Busy:
    """The running job, which the panel shows and its button cancels."""
    job = None
    text = ""


class Working:
    """Base of operators that run a Job. begin(context) checks the input and adds the job's steps; finish(context) uses
    the results and returns a message. With a window the job runs in the background; without one, or with `wait`, the
    call returns when everything is done."""
    wait: BoolProperty(name="Wait", description="Return when it is done (for scripts)", default=False,
                       options={"HIDDEN", "SKIP_SAVE"})
    timer = None

    def execute(self, context):
        """Begins the job. Called by Blender, after the file dialogue or by a script."""
        if Busy.job:
            self.report({"ERROR"}, "the program sherf is at work already; wait, or cancel it with Esc")
            return {"CANCELLED"}
        self.job = Job()
        try:
            self.begin(context)
            if bpy.app.background or self.wait or not context.window:
                while not self.job.poll():
                    time.sleep(0.02)
                return self.finished(context)
        except Failure as failure:
            return self.failed(context, failure)
        except BaseException:  # Ctrl-C, or a bug in the add-on
            self.clear(context)
            raise
        Busy.job = self.job
        self.timer = context.window_manager.event_timer_add(0.2, window=context.window)
        context.window_manager.progress_begin(0, 100)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Called by Blender for every event while the job runs in the background."""
        if (event.type == "ESC" and event.value == "PRESS") or self.job.cancelled:
            self.clear(context)
            self.report({"WARNING"}, "sherf: cancelled")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            if self.job.poll():
                return self.finished(context)
        except Failure as failure:
            return self.failed(context, failure)
        self.show(context)
        return {"PASS_THROUGH"}

    def show(self, context):
        """Shows the job's state in the status bar, the panel and the progress cursor."""
        Busy.text, done = self.job.state()
        if done is not None:
            context.window_manager.progress_update(done)
        if context.workspace:
            context.workspace.status_text_set(Busy.text + "   (Esc cancels)")
        redraw(context)

    def cancel(self, context):
        """Called by Blender when it drops the operator, for example to open another file."""
        self.clear(context)

    def clear(self, context):
        """Ends the job and takes its state out of the window."""
        self.job.close()
        if self.timer:
            context.window_manager.event_timer_remove(self.timer)
            context.window_manager.progress_end()
            self.timer = None
            Busy.job, Busy.text = None, ""
            if context.workspace:
                context.workspace.status_text_set(None)
            redraw(context)

    def failed(self, context, failure):
        """Ends the job and reports `failure` to the user. Returns Blender's CANCELLED."""
        self.clear(context)
        self.report({"ERROR"}, str(failure))
        return {"CANCELLED"}

    def finished(self, context):
        """Uses the job's results and reports them with the program's warnings. Returns FINISHED or CANCELLED."""
        try:
            said = self.finish(context)
        except Failure as failure:
            return self.failed(context, failure)
        finally:
            logs = "\n".join(self.job.logs)
            self.clear(context)
        warnings, found = program.remarks(logs, getattr(self, "photos", ()))
        for line in warnings:
            self.report({"WARNING"}, line)
        for line in found + [said]:
            self.report({"INFO"}, line)
        return {"FINISHED"}


def redraw(context):
    """Redraws the 3D views, which show the panel."""
    for area in context.screen.areas if context.screen else ():
        if area.type == "VIEW_3D":
            area.tag_redraw()


# ---- motions ----
class MotionOptions:
    """The options of a motion, shared by the import and motion operators."""
    place: EnumProperty(name="Place", default="HERE", items=(
        ("HERE", "Here", "Begins where the person stands, facing the front, feet on the floor"),
        ("FILE", "As in the file", "Where the file has the person, in its own world")))
    root: EnumProperty(name="Way", default="kept", items=(
        ("kept", "As in the file", "The person goes where the file's goes"),
        ("dropped", "On the spot", "The pelvis stays over one place"),
        ("grounded", "Feet on the ground", "The lowest part is on the ground in every frame; helps motions of videos")))
    up: EnumProperty(name="Up", description="What is up in the file", default="auto", items=(
        ("auto", "Found", ""), ("y", "y", ""), ("z", "z", ""), ("down", "-y", "y points down")))
    track: StringProperty(name="Person", description="Which person of a file of several (empty: who is there longest)")
    first: IntProperty(name="First frame", description="The file's frame to begin with", min=0, max=1000000)
    last: IntProperty(name="Last frame", description="The file's frame to end with (0: its last)", min=0, max=1000000)
    smooth: FloatProperty(name="Smooth", description="Seconds to smooth over", min=0, max=10, subtype="TIME")
    loop: BoolProperty(name="Loop", description="Make the end meet the start")
    scene_range: BoolProperty(name="Scene's range", description="Make the scene as long as the motion", default=True)

    def motion_steps(self, context, job, path, avatar, body):
        """Adds the job's steps that write `path` as BVH. If it is a video, its motion is estimated first."""
        path, tool = file_of(path), the_program(context)
        if not os.path.exists(path):
            raise Failure(f"{path}: no such file")
        if self.last and self.last < self.first:
            raise Failure("the motion's last frame comes before its first")
        if os.path.splitext(path)[1].lower() in program.VIDEOS:
            job.steps.append(("finding the motion in the video",
                              program.video_command(tool, path, job.file("video.npz"))))
            path = job.file("video.npz")
        job.steps.append(("reading the motion", program.motion_command(
            tool, avatar, path, job.file("motion.bvh"), scene_fps(context), body, self.root, self.up, self.track,
            self.first, self.last, self.smooth, self.loop)))

    def motion_put(self, context, armature, job, path):
        """Applies the job's BVH to the armature. Returns a message with the frames and the scale of the steps."""
        with open(job.file("motion.bvh"), encoding="utf-8") as f:
            clip = motion.bvh_read(f.read())
        stem = os.path.splitext(os.path.basename(path.rstrip("/\\")))[0]
        _, factor = rig.put_motion(context, armature, clip, f"{armature.name} {stem}", self.place == "HERE",
                                   scene_range=self.scene_range)
        return f"{len(clip.turns)} frames of {stem}" + ("" if factor == 1 else f", steps scaled by {factor:.2f}")

    def draw_motion(self, layout):
        """Draws the motion's options in the file dialogue."""
        for name in ("place", "root", "loop", "smooth", "first", "last", "track", "up", "scene_range"):
            layout.prop(self, name)


class SHERF_OT_motion(bpy.types.Operator, Working, MotionOptions, ImportHelper):
    """Apply a motion file (AMASS, BVH, FBX and many more) or a video of somebody to the person"""
    bl_idname = "sherf.motion"
    bl_label = "Motion to avatar"
    bl_options = {"UNDO", "PRESET"}
    filename_ext = ""
    filter_glob: StringProperty(default=MOTION_GLOB, options={"HIDDEN"}, maxlen=1024)

    @classmethod
    def poll(cls, context):
        """Blender greys the button out unless a person is active."""
        return rig.find(context) is not None

    def draw(self, context):
        """Draws the options in the file dialogue."""
        self.draw_motion(self.layout)

    def begin(self, context):
        """Adds the steps that read the motion for the active person. Raises Failure."""
        armature = rig.find(context)
        if armature is None:
            raise Failure("no person is selected; select the rig or the mesh of an avatar")
        self.armature = armature.name  # keep the name: undo may replace the object meanwhile
        avatar, self.gone = str(armature.get(rig.AVATAR, "")), ""
        if avatar and not os.path.isfile(avatar):
            avatar, self.gone = "", avatar
        body = program.body_words(the_body(context), avatar) if avatar or the_body(context) else []
        self.motion_steps(context, self.job, self.filepath, avatar, body)

    def finish(self, context):
        """Applies the motion to the person. Returns a message; raises Failure."""
        armature = bpy.data.objects.get(self.armature)
        if not rig.is_person(armature):
            raise Failure(f"{self.armature}: the person is gone")
        if self.gone:
            self.report({"WARNING"}, f"{self.gone}: the avatar file is gone; the motion is fitted by the rig's legs")
        person.object_mode(context)
        return f"{armature.name}: {self.motion_put(context, armature, self.job, file_of(self.filepath))}"


# ---- import ----
class SHERF_OT_import(bpy.types.Operator, Working, MotionOptions, ImportHelper):
    """Import a person's photo (or several, selected together), an avatar, or a .glb of sherf export as a rigged mesh"""
    bl_idname = "import_scene.sherf"
    bl_label = "Import sherf avatar"
    bl_options = {"UNDO", "PRESET"}
    filename_ext = ""
    filter_glob: StringProperty(default=IMPORT_GLOB, options={"HIDDEN"}, maxlen=1024)
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    person: IntProperty(name="Person", description="Which person of the photo (0 or 1: the largest)", min=0, max=8)
    keep: BoolProperty(name="Keep the avatar", default=True,
                       description="Keep the photo's avatar as a .safetensors beside it; motions fit better with it")
    detail: EnumProperty(name="Surface", default="MEDIUM", items=(
        ("LOW", "Coarse", "12000 triangles"), ("MEDIUM", "Middle", "50000 triangles"),
        ("HIGH", "Fine", "150000 triangles")))
    texture: EnumProperty(name="Texture", default="1024", items=[(s, s, f"{s} x {s} pixels") for s in
                                                                 ("256", "512", "1024", "2048", "4096")])
    pose: EnumProperty(name="Pose", default="REST", items=(
        ("REST", "T", "Arms stretched out"), ("PHOTO", "As in the photo", "The rig takes the photo's pose")))
    light: EnumProperty(name="Light", default="LIT", items=(
        ("LIT", "Falls on it", "The material reflects the scene's light"),
        ("PHOTO", "The photo's", "The material shines in the photo's colours, whatever the light")))
    motion: StringProperty(name="Motion", description="A motion file or video to put on, if any", subtype="FILE_PATH")

    def draw(self, context):
        """Draws the options in the file dialogue; a motion's only if one is chosen."""
        layout = self.layout
        for name in ("person", "keep", "detail", "texture", "pose", "light"):
            layout.prop(self, name)
        box = layout.box()
        box.prop(self, "motion")
        if self.motion:
            self.draw_motion(box)

    def begin(self, context):
        """Adds the steps from the chosen files to a .glb, and those of the motion. Raises Failure."""
        chosen = program.photos_of(file_of(self.filepath), [file.name for file in self.files])
        self.path = chosen[0]
        self.kind, self.photos = program.kind_of(self.path), ()
        self.avatar = self.path if self.kind == "avatar" else ""
        if self.kind == "glb":
            self.glb, body = self.path, []
        else:
            self.glb = self.job.file("person.glb")
            body = self.person_steps(context, chosen)
        if self.motion:
            self.motion_steps(context, self.job, self.motion, self.avatar, body)

    def person_steps(self, context, photos):
        """Adds the job's steps that make the avatar and the mesh. Returns the program's --body arguments."""
        tool, body = the_program(context), the_body(context)
        if self.kind == "photo":
            self.photos, self.avatar = photos, self.job.file("avatar.safetensors")
            words = program.avatar_command(tool, photos, self.avatar, self.person, body)
            self.job.steps.append(("making the avatar", words))
        words = program.body_words(body, self.path)
        self.job.steps.append(("making the mesh", program.export_command(
            tool, self.avatar, self.glb, self.detail, int(self.texture), self.pose == "PHOTO", words)))
        return words

    def finish(self, context):
        """Imports the .glb and applies the motion. Returns a message; raises Failure."""
        before = person.everything()
        name = os.path.splitext(os.path.basename(self.path.rstrip("/\\")))[0] or "person"
        try:
            armature = person.import_glb(context, self.glb, name, self.light == "LIT")
            said = f", {self.motion_put(context, armature, self.job, self.motion)}" if self.motion else ""
        except Failure:
            person.remove_new(before)
            raise
        if self.avatar:
            armature[rig.AVATAR] = self.kept(name) if self.kind == "photo" else self.avatar
        return f"{armature.name}: {len(rig.bodies_of(armature)[0].data.vertices)} vertices{said}"

    def kept(self, name):
        """Copies the photo's avatar to a permanent file. Returns its path, or "" if the avatar is not kept."""
        if not self.keep:
            return ""
        places = [os.path.dirname(self.path), bpy.utils.user_resource("DATAFILES", path="sherf", create=True)]
        for folder in places:
            path = program.free_name(folder, name, ".safetensors")
            try:
                shutil.copyfile(self.avatar, path + ".part")
                os.rename(path + ".part", path)
                return path
            except OSError:
                continue
        self.report({"WARNING"}, f"{places[0]}: cannot be written; the avatar file is not kept")
        return ""


# ---- the rest ----
class SHERF_OT_rest(bpy.types.Operator):
    """Make a T or an A the rest pose of rig and mesh; motions and poses look the same"""
    bl_idname = "sherf.rest_pose"
    bl_label = "Rest pose"
    bl_options = {"REGISTER", "UNDO"}
    pose: EnumProperty(name="Pose", items=(("T", "T", "Arms stretched out"), ("A", "A", "Arms 45 degrees lower")))

    @classmethod
    def poll(cls, context):
        """Blender greys the buttons out unless a person is active."""
        return rig.find(context) is not None

    def execute(self, context):
        """Changes the active person's rest pose."""
        person.object_mode(context)
        try:
            rig.set_rest(context, rig.find(context), self.pose)
        except Failure as failure:
            self.report({"ERROR"}, str(failure))
            return {"CANCELLED"}
        return {"FINISHED"}


class SHERF_OT_cancel(bpy.types.Operator):
    """Stop the program sherf; unfinished results are removed"""
    bl_idname = "sherf.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        """Blender greys the button out unless a job runs."""
        return Busy.job is not None

    def execute(self, context):
        """Stops the job; its operator then clears up."""
        Busy.job.cancel()
        return {"FINISHED"}


class SHERF_OT_program(bpy.types.Operator):
    """Look for the program sherf and query its version"""
    bl_idname = "sherf.program"
    bl_label = "Find the program"

    def execute(self, context):
        """Reports the program's path and version, or why there is none."""
        try:
            path = the_program(context)
            self.report({"INFO"}, f"{path}: {program.version(path)}")
        except Failure as failure:
            self.report({"ERROR"}, str(failure))
            return {"CANCELLED"}
        return {"FINISHED"}


CLASSES = (SHERF_OT_import, SHERF_OT_motion, SHERF_OT_rest, SHERF_OT_cancel, SHERF_OT_program)
