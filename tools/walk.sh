#!/bin/sh
# tools/walk.sh FRAMES: prints a walk on the spot, one step of each leg, as a pose file for `sherf render --poses`.
# x points to the body's left, y up, z to its front; the rest pose spreads the arms.
exec awk -v frames="${1:-48}" '
# The rotation about z by b, then about x by a, as an axis-angle vector.
function joint(k, a, b,    w, x, y, z, s, angle) {
    w = cos(a / 2) * cos(b / 2); x = sin(a / 2) * cos(b / 2)
    y = -sin(a / 2) * sin(b / 2); z = cos(a / 2) * sin(b / 2)
    s = sqrt(x * x + y * y + z * z)
    angle = 2 * atan2(s, w)
    if (s < 1e-9) s = 1
    pose[3 * k] = x / s * angle; pose[3 * k + 1] = y / s * angle; pose[3 * k + 2] = z / s * angle
}
function max(a, b) { return a > b ? a : b }
BEGIN {
    print "{\"frames\": ["
    for (f = 0; f < frames; f++) {
        t = 6.2831853 * f / frames
        for (i = 0; i < 72; i++) pose[i] = 0
        joint(1, -0.55 * sin(t), 0); joint(2, 0.55 * sin(t), 0)                          # hips
        joint(4, 0.15 + 0.8 * max(0, cos(t)), 0); joint(5, 0.15 + 0.8 * max(0, -cos(t)), 0) # knees
        joint(16, 0.6 * sin(t), -1.15); joint(17, -0.6 * sin(t), 1.15)                   # shoulders
        pose[3 * 18 + 1] = -0.3 - 0.3 * max(0, -sin(t)); pose[3 * 19 + 1] = 0.3 + 0.3 * max(0, sin(t)) # elbows
        pose[3 * 3 + 1] = 0.12 * sin(t); pose[3 * 6 + 1] = 0.12 * sin(t)                 # spine
        printf "{\"poses\": ["
        for (i = 0; i < 72; i++) printf "%s%.5f", i ? ", " : "", pose[i]
        printf "]}%s\n", f + 1 < frames ? "," : ""
    }
    print "]}"
}'
