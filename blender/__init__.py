"""Blender add-on: turns a photo of a person into a rigged mesh and animates it. The program sherf does the work."""
bl_info = {
    "name": "sherf",
    "author": "The sherf authors",
    "version": (0, 1, 0),
    "blender": (2, 93, 0),
    "location": "File > Import, and 3D View > N > sherf",
    "description": "A photo of a person becomes a rigged, animated mesh",
    "category": "Import-Export",
}

import bpy

from . import operators, panel


def register():
    """Called by Blender when the add-on is switched on."""
    for kind in operators.CLASSES + panel.CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.TOPBAR_MT_file_import.append(panel.menu)


def unregister():
    """Called by Blender when the add-on is switched off. Cancels a running job."""
    if operators.Busy.job:
        operators.Busy.job.cancel()
    bpy.types.TOPBAR_MT_file_import.remove(panel.menu)
    for kind in reversed(operators.CLASSES + panel.CLASSES):
        bpy.utils.unregister_class(kind)
