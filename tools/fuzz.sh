#!/usr/bin/env bash
# tools/fuzz.sh [SECONDS [NAME...]]: runs every fuzz target of tests/fuzz, or those named, for this many seconds (600,
# for a night; .ci/run: 10), one on each core. They are in BUILD (build-fuzz), which is configured and built first if it
# does not exist. New inputs stay in BUILD/corpus for the next time, beside the input of a failure. BUILD/executions
# gets a line for each run: date, name, executions, seconds.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-600}
[ $# = 0 ] || shift
export BUILD=${BUILD:-build-fuzz} seconds
export OMP_NUM_THREADS=2 LSAN_OPTIONS=suppressions=$PWD/tools/lsan.supp
jobs=${JOBS:-$(nproc)}
if [ ! -f "$BUILD/build.ninja" ]; then
    cmake -G Ninja -S . -B "$BUILD" -DCMAKE_C_COMPILER=clang -DCMAKE_BUILD_TYPE=Debug -DCMAKE_C_FLAGS_DEBUG="-O1 -g1" \
        -DSHERF_SANITIZE=ON -DSHERF_FUZZ=ON -DSHERF_TESTS=OFF >/dev/null
fi
names=("$@")
if [ ${#names[@]} = 0 ]; then
    for source in tests/fuzz/fuzz_*.c; do
        name=$(basename "$source" .c)
        names+=("${name#fuzz_}")
    done
fi
ninja -C "$BUILD" -j "$jobs" "${names[@]/#/fuzz_}" >/dev/null

fuzz() {
    local name=$1 corpus=$BUILD/corpus/$1 seeds=tests/fuzz/seeds/$1 log executions
    mkdir -p "$corpus"
    log=$corpus.log
    if ! "$BUILD/fuzz/fuzz_$name" -max_total_time="$seconds" -timeout=20 -rss_limit_mb=3000 -print_final_stats=1 \
        -artifact_prefix="$corpus." "$corpus" "$seeds" >"$log" 2>&1; then
        tail -n 60 "$log"
        echo "fuzzing $name failed" >&2
        return 1
    fi
    executions=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")
    printf '%s\t%s\t%s\t%s\n' "$(date -u +%F)" "$name" "$executions" "$seconds" >>"$BUILD/executions"
    echo "$name: $executions executions"
}
export -f fuzz
failed=0
printf '%s\0' "${names[@]}" | xargs -0 -r -n 1 -P "$jobs" bash -c 'fuzz "$1"' fuzz || failed=1
awk -F '\t' '{ n += $3 } END { print n " executions so far in this folder" }' "$BUILD/executions"
exit $failed
