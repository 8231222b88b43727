#!/usr/bin/env bash
# tools/tsan.sh [TEST...]: runs tests under clang's thread sanitizer, in BUILD (build-tsan): those of the viewer,
# training, videos and their shared code, or the named ones (ctest's names). LLVM's OpenMP reports its threads to the
# sanitizer (libarcher). oneDNN, libgomp and other Debian libraries are not instrumented and are left out.
# tools/tsan.supp suppresses reports about other projects' code. It takes minutes.
set -euo pipefail
cd "$(dirname "$0")/.."
build=${BUILD:-build-tsan}
tests=("$@")
[ $# != 0 ] || tests=(viewer_desk viewer_server train_parts train_trainer train_start avatar_animate base_base)
archer=$(find /usr/lib/llvm-*/lib -name libarcher.so | head -n 1)
[ -n "$archer" ] || { echo "tools/tsan.sh: libarcher.so is missing: apt-get install libomp-dev" >&2; exit 1; }
[ -f "$build/build.ninja" ] || cmake -G Ninja -S . -B "$build" -DCMAKE_C_COMPILER=clang -DCMAKE_BUILD_TYPE=Debug \
    -DCMAKE_C_FLAGS_DEBUG="-O1 -g1" -DSHERF_SANITIZE=thread >/dev/null
ninja -C "$build" -j "${JOBS:-$(nproc)}" sherf "${tests[@]}" >/dev/null
export SHERF_PROGRAM=$PWD/$build/sherf OMP_TOOL_LIBRARIES=$archer OMP_NUM_THREADS=3 OMP_WAIT_POLICY=passive
export TSAN_OPTIONS="suppressions=$PWD/tools/tsan.supp ignore_noninstrumented_modules=1 exitcode=66 ${TSAN_OPTIONS:-}"
failed=0
cd tests
for test in "${tests[@]}"; do
    log=../$build/tsan.$test.log
    # its shadow memory has a fixed place, so addresses must not be random
    if setarch -R "../$build/tests/$test" >"$log" 2>&1; then
        echo "$test: nothing found"
    else
        failed=1
        echo "$test: failed, or $(grep -c '^WARNING: ThreadSanitizer' "$log" || true) reports, in $build/tsan.$test.log"
    fi
done
exit $failed
