#!/bin/sh
# Every C and CUDA file must be as clang-format 14 lays it out (make format repairs).
set -eu
cd "$(dirname "$0")/.."
files=$(git ls-files '*.c' '*.h' '*.cu' '*.cpp')
# shellcheck disable=SC2086
clang-format-14 --dry-run -Werror $files
echo "style: $(echo "$files" | wc -l) files"
