#!/bin/sh
# tests/python/run.sh LIBRARY: runs the tests of python/ with Debian's Python and this build's library. Exit status 77:
# there is no NumPy.
set -eu
here=$(cd "$(dirname "$0")/../.." && pwd)
python=/usr/bin/python3
[ -x $python ] && $python -c 'import numpy' 2>/dev/null ||
    { echo "skipped: $python with NumPy (python3-numpy) is not there"; exit 77; }
export SHERF_LIBRARY="$1" SHERF_ASSETS="$here/assets" PYTHONPATH="$here/python" PYTHONDONTWRITEBYTECODE=1
exec $python -X faulthandler -W error -m unittest discover -s "$here/tests/python" -p 'test_*.py'
