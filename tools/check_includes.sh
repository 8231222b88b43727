#!/bin/sh
# Includes go down the table of rooms only (docs/architecture.md): a room may include its own headers and
# those of the rooms listed here, and sherf/sherf.h. A model's own folder, src/model/NAME, is for its files alone.
set -eu
cd "$(dirname "$0")/.."
may_include() {
    case $1 in
    base) echo "base" ;;
    tensor) echo "base tensor" ;;
    nn) echo "base tensor nn" ;;
    body) echo "base tensor body" ;;
    render) echo "base tensor nn body render" ;;
    model) echo "base tensor io nn body render data model" ;;
    io) echo "base tensor io" ;;
    data) echo "base tensor io body render data" ;;
    viewer) echo "base tensor nn body render model io viewer" ;;
    motion) echo "base tensor io body render data motion" ;;
    estimate) echo "base tensor io nn body render data model motion estimate" ;;
    synth/trace) echo "base tensor io body render synth/trace" ;;
    synth/body) echo "base tensor io body render data synth/body" ;;
    synth/people) echo "base tensor io body render data synth/body synth/trace synth/people" ;;
    synth/tube) echo "base tensor io body render data synth/tube" ;;
    train | eval) echo "base tensor nn body render model io data motion synth/people synth/tube estimate train eval" ;;
    baked) echo "base tensor io nn body render model data baked" ;;
    export) echo "base tensor io nn body render model data motion baked export" ;;
    *) return 1 ;;
    esac
}
# The room of a path below src/: its first folder, and of synth the second one too.
room_of() {
    case $1 in
    synth/*/*) room=${1#synth/}; echo "synth/${room%%/*}" ;;
    *) echo "${1%%/*}" ;;
    esac
}
wrong=0
complain() {
    echo "$1" >&2
    wrong=1
}
for file in $(git ls-files 'src/*.c' 'src/*.h' 'src/*.inc' 'src/*.cu'); do
    room=$(room_of "${file#src/}")
    rooms=$(may_include "$room") || { complain "$file: the room '$room' is not in the table"; continue; }
    for header in $(sed -n 's/^[[:space:]]*#[[:space:]]*include[[:space:]]*"\([^"]*\)".*/\1/p' "$file"); do
        case $header in
        model/*/*)
            owner=${header#model/}
            owner=${owner%%/*}
            case $file in
            src/model/"$owner"/*) ;;
            *) complain "$file: includes \"$header\": the model's own; others know src/model/*.h" ;;
            esac ;;
        sherf/sherf.h) ;;
        */*)
            case " $rooms " in
            *" $(room_of "$header") "*) ;;
            *) # a path inside the room, as "ops/x.h" from src/tensor
                [ -f "$(dirname "$file")/$header" ] && case $header in ../*) false ;; esac ||
                    complain "$file: includes \"$header\", which is not below $room" ;;
            esac ;;
        *) [ -f "$(dirname "$file")/$header" ] || complain "$file: includes \"$header\", which is not in its folder" ;;
        esac
    done
done
# The program is made of the public API alone.
for file in $(git ls-files 'cli/*.c' 'cli/*.h' 'docs/*.c'); do
    for header in $(sed -n 's/^[[:space:]]*#[[:space:]]*include[[:space:]]*"\([^"]*\)".*/\1/p' "$file"); do
        [ "$header" = sherf/sherf.h ] || [ -f "$(dirname "$file")/$header" ] ||
            complain "$file: includes \"$header\": only sherf/sherf.h is public"
    done
done
[ $wrong = 0 ] && echo "includes: go down only"
exit $wrong
