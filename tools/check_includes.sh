#!/bin/sh
# tools/check_includes.sh: checks includes and calls against the table of rooms in docs/architecture.md. A room's
# sources may include its own headers and those of the rooms in the table's last column, which are all above it, and may
# call only public functions (sherf/sherf.h) that are defined there. The program and the examples in docs include only
# sherf/sherf.h.
set -eu
cd "$(dirname "$0")/.."
files=$(git ls-files 'src/*.c' 'src/*.h' 'src/*.inc' 'src/*.cu' 'cli/*.c' 'cli/*.h' 'docs/*.c')
# shellcheck disable=SC2086
awk '
function complain(text) { print text > "/dev/stderr"; wrong = 1 }
function folder(path) { return match(path, /.*\//) ? substr(path, 1, RLENGTH - 1) : "." }
# The innermost room that contains the path below src/.
function room_of(path) {
    while (sub(/\/[^\/]*$/, "", path)) if (path in rank) return path
    return ""
}
function may(from, to) { return from == to || index(below[from], " " to " ") > 0 }
function include(file, header,    where) {
    where = folder(file)
    if (header == "sherf/sherf.h") return
    if (file !~ /^src\//) {
        if (!((where "/" header) in exists)) complain(file ": includes \"" header "\": only sherf/sherf.h is public")
    } else if (("src/" header) in exists) {
        if (!may(room, room_of(header))) complain(file ": includes \"" header "\", which is not below " room)
    } else if (header ~ /^\.\.\// || !((where "/" header) in exists))
        complain(file ": includes \"" header "\", which is neither below " room " nor in its folder")
}
# A definition begins a line; any other mention is a use.
function names(file, line,    name, defines) {
    gsub(/\/\*[^*]*\*\//, "", line)
    if (line ~ /^ *(\/\*|\*)/) return
    defines = file ~ /\.c$/ && line ~ /^[a-z].*\(/ && line !~ /;$/
    while (match(line, /sherf_[a-z0-9_]+/)) {
        name = substr(line, RSTART, RLENGTH)
        line = substr(line, RSTART + RLENGTH)
        if (!(name in public)) continue
        if (defines && line ~ /^\(/) home[name] = file
        else if (!((file, name) in seen)) { seen[file, name] = 1; use[++uses] = file " " name }
        defines = 0
    }
}
BEGIN {
    while ((getline line < "docs/architecture.md") > 0) {
        if (line !~ /^\| `src\//) continue
        split(line, cell, "|")
        room = cell[2]
        gsub(/[` ]|src\/|\/`/, "", room)
        sub(/\/$/, "", room)
        gsub(/[ ]/, "", cell[4])
        rooms = cell[4] == "-" ? 0 : split(cell[4], list, ",")
        below[room] = " "
        for (i = 1; i <= rooms; i++) {
            if (!(list[i] in rank))
                complain("docs/architecture.md: " list[i] ", below " room ", does not stand above it")
            below[room] = below[room] list[i] " "
        }
        rank[room] = 1
    }
    while ((getline line < "include/sherf/sherf.h") > 0) {
        api = api || line ~ /SHERF_API/
        if (api && match(line, /sherf_[a-z0-9_]+\(/)) { public[substr(line, RSTART, RLENGTH - 1)] = 1; api = 0 }
    }
    for (i = 1; i < ARGC; i++) exists[ARGV[i]] = 1
    for (i = 1; i < ARGC; i++) {
        file = ARGV[i]
        room = file ~ /^src\// ? room_of(substr(file, 5)) : ""
        if (file ~ /^src\// && room == "") complain(file ": its room is not in the table of docs/architecture.md")
        while ((getline line < file) > 0) {
            if (match(line, /^[ \t]*#[ \t]*include[ \t]*"[^"]*"/)) {
                split(line, part, "\"")
                include(file, part[2])
            } else if (room != "")
                names(file, line)
        }
        close(file)
    }
    for (i = 1; i <= uses; i++) {
        split(use[i], part, " ")
        file = part[1]; name = part[2]
        if (!(name in home)) { complain(file ": uses " name ", which nobody defines"); continue }
        room = room_of(substr(file, 5))
        to = room_of(substr(home[name], 5))
        if (!may(room, to)) complain(file ": calls " name " (" home[name] "), which is not below " room)
    }
    if (!wrong) print "includes and calls: within the table of rooms"
    exit wrong
}' $files
