#!/bin/sh
# tools/check_export.sh [FILE.glb|SPLATS.ply ...]: passes exported files to other projects' programs from npm: Khronos'
# glTF validator and gsplat's loader. Without arguments it checks the files of tests/export (built in BUILD, ./build).
# If npm is missing or cannot fetch the programs, it checks nothing and says so.
set -eu
cd "$(dirname "$0")/.."
root=$PWD build=${BUILD:-build}
skip() { echo "check_export: skipped, $1"; exit 0; }
command -v node >/dev/null && command -v npm >/dev/null || skip "there is no node and npm"
tools=$build/check_export
mkdir -p "$tools"
if ! [ -d "$tools/node_modules/gsplat" ] || ! [ -d "$tools/node_modules/gltf-validator" ]; then
    (cd "$tools" && npm install --silent --no-save --no-audit --no-fund gltf-validator@2.0.0-dev.3.10 \
        gsplat@1.2.9 >/dev/null 2>&1) ||
        skip "npm cannot fetch gltf-validator and gsplat"
fi
if [ $# = 0 ]; then
    [ -x "$build/tests/export_files" ] || skip "$build/tests/export_files is not built"
    rm -rf "$tools/files"
    mkdir "$tools/files"
    SHERF_EXPORT_FOLDER=$PWD/$tools/files "$build/tests/export_files" >/dev/null 2>&1 ||
        { echo "$build/tests/export_files fails" >&2; exit 1; }
    set -- "$tools"/files/*.glb "$tools"/files/splats.ply
fi
for file in "$@"; do
    case $file in /*) ;; *) file=$root/$file ;; esac
    (cd "$tools" && node "$root/tools/check_export.mjs" "$file")
done
