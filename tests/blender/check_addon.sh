#!/bin/sh
# tests/blender/check_addon.sh BLENDER PYTHON SHERF [PICTURES]: makes the add-on's zip and tests it in a Blender that
# neither reads nor changes the user's settings.
set -eu
here=$(cd "$(dirname "$0")/../.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/scripts" "$work/config"
export BLENDER_USER_SCRIPTS="$work/scripts" BLENDER_USER_CONFIG="$work/config" TMPDIR="$work"
"$2" -B "$here/tools/blender_zip.py" "$work/sherf-blender.zip"
"$1" --background --factory-startup --threads 2 --python "$here/tests/blender/check_addon.py" -- \
    "$work/sherf-blender.zip" "$3" "$here/assets/demo/photo.jpg" ${4:+"$4"}
