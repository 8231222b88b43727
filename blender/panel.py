"""The panel (3D View, N, tab sherf), the menu entry and the preferences."""
import bpy
from bpy.props import StringProperty

from . import operators, rig


class SherfPreferences(bpy.types.AddonPreferences):
    """Where the program and the body model are."""
    bl_idname = __package__
    program: StringProperty(name="Program", description="The program sherf (empty: on PATH, or beside the add-on)",
                            subtype="FILE_PATH")
    body: StringProperty(name="Body", description="The body model of the avatars (empty: the open body)",
                         subtype="FILE_PATH")

    def draw(self, context):
        """Draws the fields and the button that tries the program."""
        self.layout.prop(self, "program")
        self.layout.prop(self, "body")
        self.layout.operator("sherf.program", icon="VIEWZOOM")


class VIEW3D_PT_sherf(bpy.types.Panel):
    """The panel: import, the active person's motion and rest pose, or the running job."""
    bl_label = "sherf"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "sherf"

    def draw(self, context):
        """Draws the running job, or the import buttons and the person."""
        layout = self.layout
        if operators.Busy.job:
            layout.label(text=operators.Busy.text or "sherf")
            layout.operator("sherf.cancel", icon="X")
            return
        column = layout.column()
        column.operator_context = "INVOKE_DEFAULT"
        column.operator("import_scene.sherf", text="Photo to avatar", icon="IMAGE_DATA").filter_glob = \
            operators.PHOTO_GLOB
        column.operator("import_scene.sherf", text="Import avatar", icon="IMPORT").filter_glob = "*.safetensors;*.glb"
        self.person(layout, rig.find(context))

    def person(self, layout, armature):
        """Draws the box of the active person; `armature` is None if there is none."""
        box = layout.box()
        if armature is None:
            box.label(text="Select an avatar", icon="INFO")
            return
        box.label(text=armature.name, icon="ARMATURE_DATA")
        column = box.column()
        column.operator_context = "INVOKE_DEFAULT"
        column.operator("sherf.motion", icon="ANIM")
        action = rig.action_of(armature)
        if action:
            first, last = action.frame_range
            box.label(text=f"{action.name}: {first:.0f} to {last:.0f}")
        row = box.row(align=True)
        row.label(text="Rest pose")
        for pose in "TA":
            row.operator("sherf.rest_pose", text=pose,
                         depress=armature.get("sherf_rest_pose", "T") == pose).pose = pose


def menu(self, context):
    """The entry in File > Import."""
    self.layout.operator("import_scene.sherf", text="sherf avatar (.safetensors, .glb, photo)")


CLASSES = (SherfPreferences, VIEW3D_PT_sherf)
