#!/usr/bin/env bash
# tools/memory_limits.sh SHERF [LEVELS]: runs avatar, render, export, bake and train under `ulimit -v`, at LEVELS (10)
# even fractions of the memory that each uses without a limit. Every run either gives the same result as without a
# limit, or ends with exit status 1 and one line on standard error, and leaves neither an output nor a half-written
# file. Limits too low for the system to load the program (127) are counted separately.
set -euo pipefail
sherf=$(realpath "$1")
levels=${2:-10}
root=$(realpath "$(dirname "$0")/..")
export SHERF_ASSETS=${SHERF_ASSETS:-$root/assets}
. "$root/tools/tiny.sh"
cd "$work"

fail() {
    echo "FAILED: $*" >&2
    sed 's/^/    /' stderr >&2
    failures=$((failures + 1))
}

words_of() {
    case $1 in
    avatar) words=(avatar "thuman:$root/assets/demo#person_900006/0/0" -o "$2/a.safetensors") ;;
    render) words=(render whole/a.safetensors --size 128 -o "$2/picture.png") ;;
    export) words=(export whole/a.safetensors -r 96 -o "$2/person.glb") ;;
    bake) words=(bake whole/a.safetensors -r 96 --triangles 5000 --texture 256 -o "$2/b.safetensors") ;;
    train) words=(train -d thuman:people -P 0 -p "$tiny" -s 32 -n 4 --batch 1 --perceptual none -o "$2/run") ;;
    esac
    words+=(-q)
}

# The peak of the program's address space, KiB.
peak_of() {
    local pid now peak=0
    words_of "$1" whole
    "$sherf" "${words[@]}" >/dev/null &
    pid=$!
    while now=$(awk '/^VmPeak/ { print $2 }' "/proc/$pid/status" 2>/dev/null) && [ -n "$now" ]; do
        peak=$now
        sleep 0.01
    done
    wait "$pid"
    echo "$peak"
}

# A training that runs out of memory midway keeps its folder, log and checkpoint, so it can continue.
check_failed() {
    local what=$1 left
    [ "$(wc -l <stderr)" = 1 ] || fail "$what: not one line but $(wc -l <stderr)"
    grep -q '^sherf: ' stderr || fail "$what: the line is not the program's"
    left=$(find got -type f \( ! -path 'got/run/*' -o -name '*.part' \))
    [ -z "$left" ] || fail "$what: left $left"
}

try() {
    local verb=$1 peak level limit rc whole=0 clear=0 loader=0
    peak=$(peak_of "$verb")
    for level in $(seq 1 "$levels"); do
        limit=$((peak * level / levels))
        rm -rf got
        mkdir got
        words_of "$verb" got
        rc=0
        (ulimit -v $limit && exec "$sherf" "${words[@]}" >/dev/null 2>stderr) || rc=$?
        case $rc in
        0) whole=$((whole + 1)) ;;
        127) loader=$((loader + 1)) ;;
        1)
            clear=$((clear + 1))
            check_failed "$verb with $((limit / 1024)) MiB"
            [ -z "${SHOW:-}" ] || sed "s/^/    $((limit / 1024)) MiB: /" stderr
            ;;
        *) fail "$verb with $((limit / 1024)) MiB: ended with $rc" ;;
        esac
    done
    echo "$verb: $((peak / 1024)) MiB without a limit; of $levels limits $whole let it end whole," \
        "$clear gave one line, $loader did not let it load"
}

mkdir whole
"$sherf" synth tube -o people --people 1 --poses 1 --views 8 --size 32 -q
for verb in avatar render export bake train; do try "$verb"; done
[ $failures = 0 ] || { echo "$failures failures" >&2; exit 1; }
