#!/bin/sh
# tools/check_style.sh: checks the style of all files. Every C and CUDA file has clang-format 14's layout (make format
# repairs it). Pages, scripts and build files keep to 120 columns, except tables, pictures and code blocks in pages, and
# checksums. Every file begins with a comment about its purpose.
set -eu
cd "$(dirname "$0")/.."
files=$(git ls-files '*.c' '*.h' '*.cu' '*.cpp')
# shellcheck disable=SC2086
clang-format-14 --dry-run -Werror $files
texts=$(git ls-files '*.md' '*.sh' '*.py' '*.js' '*.mjs' '*.cmake' '*CMakeLists.txt' Makefile packages.txt .ci/run \
    debian/rules)
# shellcheck disable=SC2086
if LC_ALL=C.UTF-8 grep -HnE '^.{121,}$' $texts |
    grep -vE '^[^:]*\.md:[0-9]+:(\||!\[|    )|[0-9a-f]{128}'; then
    echo "style: longer than 120 columns" >&2
    exit 1
fi
# shellcheck disable=SC2086
for file in $files $(git ls-files '*.inc' '*.sh' '*.py' '*.js' '*.mjs'); do
    case $(grep -m1 -vE '^(#!.*|[[:space:]]*)$' "$file") in
    '/*'* | '//'* | '# '* | '"""'*) ;;
    *) echo "style: $file does not open with what it is" >&2 && exit 1 ;;
    esac
done
echo "style: $(echo "$files" | wc -l) files, $(echo "$texts" | wc -l) texts"
