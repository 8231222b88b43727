/* Converts a scene's nodes to joints: scale is dropped, and rotations are relative to the bind pose. */
#include "io/scene_clip.h"

#include <math.h>
#include <string.h>

const char *scene_clip_kind(const unsigned char *data, size_t bytes) {
    if (bytes >= 18 && !memcmp(data, "Kaydara FBX Binary", 18)) return "FBX";
    if (bytes >= 5 && !memcmp(data, "; FBX", 5)) return "FBX";
    return bytes >= 4 && !memcmp(data, "glTF", 4) ? "GLB" : NULL;
}

#ifdef SHERF_HAVE_ASSIMP
#include <assimp/cimport.h>
#include <assimp/config.h>
#include <assimp/scene.h>

enum { RATE_MAX = 240, VALUES_MAX = 1 << 26 };

typedef struct {
    double m[9], t[3]; /* x = m x' + t */
} affine;

typedef struct {
    const struct aiScene *scene;
    const struct aiAnimation *animation;
    const struct aiNode *node[BVH_JOINTS_MAX];
    const struct aiNodeAnim *moved[BVH_JOINTS_MAX]; /* NULL: the node's own transformation */
    int parent[BVH_JOINTS_MAX], joints;
    affine bind[BVH_JOINTS_MAX], now[BVH_JOINTS_MAX];
    bool bound[BVH_JOINTS_MAX];
} scene_job;

static affine affine_of(const struct aiMatrix4x4 *a) {
    return (affine){{a->a1, a->a2, a->a3, a->b1, a->b2, a->b3, a->c1, a->c2, a->c3}, {a->a4, a->b4, a->c4}};
}

static affine compose(const affine *a, const affine *b) {
    affine out;
    for (int i = 0; i < 9; i++)
        out.m[i] = a->m[i / 3 * 3] * b->m[i % 3] + a->m[i / 3 * 3 + 1] * b->m[3 + i % 3] +
                   a->m[i / 3 * 3 + 2] * b->m[6 + i % 3];
    for (int i = 0; i < 3; i++)
        out.t[i] = a->m[3 * i] * b->t[0] + a->m[3 * i + 1] * b->t[1] + a->m[3 * i + 2] * b->t[2] + a->t[i];
    return out;
}

/* false: it has no inverse. */
static bool inverse_of(const affine *a, affine *out) {
    const double *m = a->m;
    const double d = m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
                     m[2] * (m[3] * m[7] - m[4] * m[6]);
    if (!(fabs(d) > 1e-30)) return false;
    for (int i = 0; i < 9; i++) {
        const int r = i % 3, q = i / 3, r1 = (r + 1) % 3, r2 = (r + 2) % 3, q1 = (q + 1) % 3,
                  q2 = (q + 2) % 3;
        out->m[i] = (m[3 * r1 + q1] * m[3 * r2 + q2] - m[3 * r1 + q2] * m[3 * r2 + q1]) / d;
    }
    for (int i = 0; i < 3; i++)
        out->t[i] = -(out->m[3 * i] * a->t[0] + out->m[3 * i + 1] * a->t[1] + out->m[3 * i + 2] * a->t[2]);
    return true;
}

/* The rotation in a matrix that may be scaled: its columns orthonormalised. Identity if there is none. */
static void rotation_in(const double m[9], double R[9]) {
    double x[3] = {m[0], m[3], m[6]}, y[3] = {m[1], m[4], m[7]}, z[3], length = 0, along = 0, rest = 0;
    for (int k = 0; k < 3; k++) length += x[k] * x[k];
    for (int k = 0; k < 3; k++) x[k] /= length > 0 ? sqrt(length) : 1;
    for (int k = 0; k < 3; k++) along += x[k] * y[k];
    for (int k = 0; k < 3; k++) y[k] -= along * x[k], rest += y[k] * y[k];
    for (int k = 0; k < 3; k++) y[k] /= rest > 0 ? sqrt(rest) : 1;
    for (int k = 0; k < 3; k++) z[k] = x[(k + 1) % 3] * y[(k + 2) % 3] - x[(k + 2) % 3] * y[(k + 1) % 3];
    for (int k = 0; k < 3; k++) R[3 * k] = x[k], R[3 * k + 1] = y[k], R[3 * k + 2] = z[k];
    if (length > 0 && rest > 0) return;
    for (int k = 0; k < 9; k++) R[k] = k % 4 == 0;
}

/* ---- nodes, the animation, the bind pose ---- */

/* Depth first, so that parents precede their children, with an explicit stack instead of recursion. */
static bool gather_nodes(scene_job *j) {
    const struct aiNode *stack[BVH_JOINTS_MAX];
    int above[BVH_JOINTS_MAX], depth = 0;
    stack[depth] = j->scene->mRootNode, above[depth++] = -1;
    while (depth) {
        const struct aiNode *n = stack[--depth];
        const int parent = above[depth], own = j->joints;
        if (own == BVH_JOINTS_MAX || n->mNumChildren > (unsigned)(BVH_JOINTS_MAX - depth)) return false;
        j->node[own] = n, j->parent[own] = parent, j->joints++;
        for (unsigned i = n->mNumChildren; i-- > 0;) stack[depth] = n->mChildren[i], above[depth++] = own;
    }
    return true;
}

static int node_named(const scene_job *j, const char *name) {
    for (int i = 0; i < j->joints; i++)
        if (!strcmp(j->node[i]->mName.data, name)) return i;
    return -1;
}

static void choose_animation(scene_job *j) {
    for (unsigned i = 0; i < j->scene->mNumAnimations; i++) {
        const struct aiAnimation *a = j->scene->mAnimations[i];
        if (!j->animation || a->mNumChannels > j->animation->mNumChannels) j->animation = a;
    }
    for (unsigned i = 0; j->animation && i < j->animation->mNumChannels; i++) {
        const int n = node_named(j, j->animation->mChannels[i]->mNodeName.data);
        if (n >= 0) j->moved[n] = j->animation->mChannels[i];
    }
}

/* Places each node by the nodes' own transformations. */
static void place_nodes(scene_job *j) {
    for (int i = 0; i < j->joints; i++) {
        const affine own = affine_of(&j->node[i]->mTransformation);
        j->now[i] = j->parent[i] < 0 ? own : compose(&j->now[j->parent[i]], &own);
    }
}

/* Bones have their place at the time when the skin was bound; other nodes keep their place relative to their
 * parent. */
static void bind_nodes(scene_job *j) {
    place_nodes(j);
    for (int i = 0; i < j->joints; i++)
        for (unsigned k = 0; k < j->node[i]->mNumMeshes; k++) {
            const struct aiMesh *mesh = j->scene->mMeshes[j->node[i]->mMeshes[k]];
            for (unsigned n = 0; n < mesh->mNumBones; n++) {
                const int bone = node_named(j, mesh->mBones[n]->mName.data);
                const affine offset = affine_of(&mesh->mBones[n]->mOffsetMatrix);
                affine back;
                if (bone < 0 || j->bound[bone] || !inverse_of(&offset, &back)) continue;
                j->bind[bone] = compose(&j->now[i], &back);
                j->bound[bone] = true;
            }
        }
    for (int i = 0; i < j->joints; i++) {
        const affine own = affine_of(&j->node[i]->mTransformation);
        if (!j->bound[i]) j->bind[i] = j->parent[i] < 0 ? own : compose(&j->bind[j->parent[i]], &own);
    }
}

/* ---- keys ---- */

/* The keys on either side of a time, and the second one's share. */
#define KEYS_AT(keys, count, time, a, b, share)                                                              \
    do {                                                                                                     \
        unsigned low_ = 0, high_ = (count)-1;                                                                \
        while (high_ - low_ > 1) {                                                                           \
            const unsigned middle_ = (low_ + high_) / 2;                                                     \
            if ((keys)[middle_].mTime <= (time))                                                             \
                low_ = middle_;                                                                              \
            else                                                                                             \
                high_ = middle_;                                                                             \
        }                                                                                                    \
        const double span_ = (keys)[high_].mTime - (keys)[low_].mTime;                                       \
        (a) = low_, (b) = high_;                                                                             \
        (share) = span_ > 0 ? fmin(fmax(((time) - (keys)[low_].mTime) / span_, 0), 1) : 0;                   \
    } while (0)

static void vector_at(const struct aiVectorKey *keys, unsigned count, double time, double out[3]) {
    unsigned a, b;
    double s;
    KEYS_AT(keys, count, time, a, b, s);
    out[0] = (1 - s) * keys[a].mValue.x + s * keys[b].mValue.x;
    out[1] = (1 - s) * keys[a].mValue.y + s * keys[b].mValue.y;
    out[2] = (1 - s) * keys[a].mValue.z + s * keys[b].mValue.z;
}

/* Keys are close together, so linear interpolation of quaternions is as good as slerp. */
static void turn_at(const struct aiQuatKey *keys, unsigned count, double time, double R[9]) {
    unsigned a, b;
    double s, q[4], length = 0;
    KEYS_AT(keys, count, time, a, b, s);
    const double from[4] = {keys[a].mValue.w, keys[a].mValue.x, keys[a].mValue.y, keys[a].mValue.z};
    const double to[4] = {keys[b].mValue.w, keys[b].mValue.x, keys[b].mValue.y, keys[b].mValue.z};
    const double sign = from[0] * to[0] + from[1] * to[1] + from[2] * to[2] + from[3] * to[3] < 0 ? -1 : 1;
    for (int k = 0; k < 4; k++) q[k] = (1 - s) * from[k] + sign * s * to[k], length += q[k] * q[k];
    for (int k = 0; k < 4; k++) q[k] = length > 0 ? q[k] / sqrt(length) : k == 0;
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double m[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    memcpy(R, m, sizeof m);
}

static affine moved_at(const struct aiNodeAnim *n, const struct aiNode *node, double time) {
    affine own = affine_of(&node->mTransformation);
    double scale[3] = {1, 1, 1};
    if (n->mNumPositionKeys) vector_at(n->mPositionKeys, n->mNumPositionKeys, time, own.t);
    if (!n->mNumRotationKeys) return own;
    turn_at(n->mRotationKeys, n->mNumRotationKeys, time, own.m);
    if (n->mNumScalingKeys) vector_at(n->mScalingKeys, n->mNumScalingKeys, time, scale);
    for (int i = 0; i < 9; i++) own.m[i] *= scale[i % 3];
    return own;
}

/* ---- as a BVH ---- */

/* R = Rz Rx Ry, in degrees. */
static void euler_zxy(const double R[9], float out[3]) {
    const double degree = 180 / M_PI;
    out[1] = (float)(asin(fmax(-1, fmin(1, R[7]))) * degree);
    const bool upright = fabs(R[7]) > 1 - 1e-9; /* z and y turn about the same axis */
    out[0] = (float)((upright ? atan2(R[3], R[0]) : atan2(-R[1], R[4])) * degree);
    out[2] = upright ? 0 : (float)(atan2(-R[6], R[8]) * degree);
}

static void transposed_times(const double a[9], const double b[9], double out[9]) {
    for (int i = 0; i < 9; i++)
        out[i] = a[i / 3] * b[i % 3] + a[3 + i / 3] * b[3 + i % 3] + a[6 + i / 3] * b[6 + i % 3];
}

/* A joint's rotation since the bind pose, in the world. */
static void turned_since(const affine *now, const affine *bind, double out[9]) {
    double R[9], B[9], Rt[9], Bt[9];
    rotation_in(now->m, R);
    rotation_in(bind->m, B);
    for (int i = 0; i < 9; i++) Rt[i] = R[i % 3 * 3 + i / 3], Bt[i] = B[i % 3 * 3 + i / 3];
    transposed_times(Rt, Bt, out); /* R B^T */
}

static sherf_status frame_values(context *c, scene_job *j, double time, float *values) {
    static const double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    double(*turned)[9] = mem_alloc(c, (size_t)j->joints, sizeof *turned);
    if (!turned) return SHERF_NO_MEMORY;
    for (int i = 0; i < j->joints; i++, values += 6) {
        const int p = j->parent[i];
        const affine own =
            j->moved[i] ? moved_at(j->moved[i], j->node[i], time) : affine_of(&j->node[i]->mTransformation);
        double local[9], far_off = 0;
        j->now[i] = p < 0 ? own : compose(&j->now[p], &own);
        turned_since(&j->now[i], &j->bind[i], turned[i]);
        const double *up = p < 0 ? unit : turned[p];
        transposed_times(up, turned[i], local);
        for (int k = 0; k < 3; k++) {
            double sum = 0;
            for (int n = 0; n < 3; n++)
                sum += up[3 * n + k] * (j->now[i].t[n] - (p < 0 ? 0 : j->now[p].t[n]));
            values[k] = (float)sum;
            far_off = fmax(far_off, fabs(sum));
        }
        euler_zxy(local, values + 3);
        if (!(far_off < 1e9)) {
            mem_free(turned);
            return failure(c, SHERF_BAD_FILE, "%.60s is nowhere at %g", j->node[i]->mName.data, time);
        }
    }
    mem_free(turned);
    return SHERF_OK;
}

/* The frame rate, in frames per second, of the joint with the most keys; 30 if curves have few. */
static double rate_of(const struct aiAnimation *a, double seconds) {
    enum { RATE_MIN = 20, USUAL = 30 };
    unsigned keys = 2;
    for (unsigned i = 0; i < a->mNumChannels; i++)
        if (a->mChannels[i]->mNumRotationKeys > keys) keys = a->mChannels[i]->mNumRotationKeys;
    const double rate = seconds > 0 ? round((keys - 1) / seconds) : USUAL;
    return rate < RATE_MIN ? USUAL : fmin(rate, RATE_MAX);
}

static sherf_status clip_of(context *c, scene_job *j, bvh *b) {
    const double ticks = j->animation->mTicksPerSecond > 0 ? j->animation->mTicksPerSecond : 25;
    const double seconds = j->animation->mDuration / ticks, rate = rate_of(j->animation, seconds);
    if (!(seconds >= 0 && seconds * rate * j->joints * 6 < VALUES_MAX))
        return failure(c, SHERF_BAD_FILE, "an animation of %g s and %d nodes is too long", seconds,
                       j->joints);
    b->frames = (int)lround(seconds * rate) + 1;
    b->frame_time_s = 1 / rate;
    b->joints = j->joints;
    b->channels = 6 * j->joints;
    b->joint = mem_zero(c, (size_t)j->joints, sizeof *b->joint);
    b->value = mem_alloc(c, (size_t)b->frames * (size_t)b->channels, sizeof *b->value);
    if (!b->joint || !b->value) return SHERF_NO_MEMORY;
    for (int i = 0; i < j->joints; i++) {
        static const uint8_t channels[6] = {BVH_X_POSITION, BVH_Y_POSITION, BVH_Z_POSITION,
                                            BVH_Z_ROTATION, BVH_X_ROTATION, BVH_Y_ROTATION};
        bvh_joint *to = &b->joint[i];
        *to = (bvh_joint){.parent = j->parent[i], .first = 6 * i, .channels = 6};
        for (size_t n = 0; n + 1 < BVH_NAME && j->node[i]->mName.data[n]; n++)
            to->name[n] = j->node[i]->mName.data[n];
        memcpy(to->channel, channels, sizeof channels);
        for (int k = 0; k < 3; k++)
            to->offset[k] = j->bind[i].t[k] - (j->parent[i] < 0 ? 0 : j->bind[j->parent[i]].t[k]);
    }
    sherf_status status = SHERF_OK;
    for (int i = 0; i < 3 * j->joints && !status; i++)
        if (!(fabs(b->joint[i / 3].offset[i % 3]) < 1e9))
            status = failure(c, SHERF_BAD_FILE, "%.60s is nowhere at rest", b->joint[i / 3].name);
    for (int f = 0; f < b->frames && !status; f++)
        status = frame_values(c, j, f / rate * ticks, b->value + (size_t)f * (size_t)b->channels);
    return status;
}

static sherf_status convert(context *c, const struct aiScene *scene, bvh **out) {
    scene_job *j = mem_zero(c, 1, sizeof *j);
    bvh *b = mem_zero(c, 1, sizeof *b);
    sherf_status status = j && b ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) j->scene = scene;
    if (!status && (!scene->mRootNode || !gather_nodes(j)))
        status = failure(c, SHERF_BAD_FILE, "more than %d nodes", BVH_JOINTS_MAX);
    if (!status) choose_animation(j);
    if (!status && !j->animation) status = failure(c, SHERF_BAD_FILE, "no animation in it");
    if (!status) bind_nodes(j);
    if (!status) status = clip_of(c, j, b);
    mem_free(j);
    if (!status) *out = b;
    if (status) bvh_free(b);
    return status;
}

sherf_status scene_clip_read(context *c, const char *path, bvh **out) {
    struct aiPropertyStore *settings = aiCreatePropertyStore();
    *out = NULL;
    if (!settings) return failure(c, SHERF_NO_MEMORY, "out of memory");
    aiSetImportPropertyInteger(settings, AI_CONFIG_IMPORT_FBX_PRESERVE_PIVOTS, 0);
    aiSetImportPropertyInteger(settings, AI_CONFIG_IMPORT_FBX_READ_TEXTURES, 0);
    const struct aiScene *scene = aiImportFileExWithProperties(path, 0, NULL, settings);
    aiReleasePropertyStore(settings);
    if (!scene) return failure(c, SHERF_BAD_FILE, "cannot be read: %.200s", aiGetErrorString());
    sherf_status status = convert(c, scene, out);
    aiReleaseImport(scene);
    return status;
}
#else
sherf_status scene_clip_read(context *c, const char *path, bvh **out) {
    *out = NULL;
    return failure(c, SHERF_UNSUPPORTED, "this build reads no FBX and GLB (libassimp was not there)");
}
#endif
