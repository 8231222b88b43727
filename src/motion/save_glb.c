/* A motion without a mesh as binary glTF 2.0 (Khronos): the 24 joints as nodes and bones, and one animation.
 */
#include <string.h>

#include "base/path.h"
#include "data/bvh_names.h"
#include "data/text.h"
#include "motion/motion.h"

/* The binary chunk: seconds [F], pelvis positions [F, 3], and for each joint its rotations [F, 4] as x y z w.
 */
static sherf_status bytes_make(context *c, const clip *k, float **out) {
    const size_t frames = (size_t)k->frames;
    float *to = *out = mem_alloc(c, frames, (1 + 3 + 4 * BODY_JOINTS) * sizeof *to);
    if (!to) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < frames; i++) *to++ = (float)((double)i / k->fps);
    memcpy(to, k->pelvis_m, frames * sizeof *k->pelvis_m);
    to += 3 * frames;
    for (int j = 0; j < BODY_JOINTS; j++)
        for (size_t i = 0; i < frames; i++, to += 4) {
            const float *q = k->turn[i][j];
            /* q and -q are one rotation: takes the nearer one, for programs that interpolate */
            const float dot = i ? to[-4] * q[1] + to[-3] * q[2] + to[-2] * q[3] + to[-1] * q[0] : 1;
            const float sign = dot < 0 ? -1.f : 1.f;
            for (int a = 0; a < 4; a++) to[a] = sign * q[(a + 1) % 4];
        }
    return SHERF_OK;
}

static void nodes_text(const sherf_motion *motion, text_builder *t) {
    const double(*rest)[3] = motion->skeleton.rest_m;
    text_add(t, "\"nodes\":[");
    for (int j = 0; j < BODY_JOINTS; j++) {
        const int p = skeleton_parent[j];
        bool any = false;
        text_add(t, "%s{\"name\":\"%s\",\"translation\":[", j ? "," : "", joint_name(j));
        for (int a = 0; a < 3; a++)
            text_add(t, "%s%.9g", a ? "," : "",
                     p < 0 ? (double)motion->clip.pelvis_m[0][a] : rest[j][a] - rest[p][a]);
        text_add(t, "]");
        for (int i = j + 1; i < BODY_JOINTS; i++) {
            if (skeleton_parent[i] != j) continue;
            text_add(t, "%s%d", any ? "," : ",\"children\":[", i);
            any = true;
        }
        text_add(t, any ? "]}" : "}");
    }
    text_add(t, "],\"skins\":[{\"skeleton\":0,\"joints\":[0");
    for (int j = 1; j < BODY_JOINTS; j++) text_add(t, ",%d", j);
    text_add(t, "]}],");
}

/* Sampler and accessor 1 are the pelvis's positions, 2 + j the rotations of joint j. */
static void animation_text(text_builder *t) {
    text_add(t, "\"animations\":[{\"name\":\"motion\",\"samplers\":[{\"input\":0,\"output\":1}");
    for (int j = 0; j < BODY_JOINTS; j++) text_add(t, ",{\"input\":0,\"output\":%d}", 2 + j);
    text_add(t, "],\"channels\":[{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"translation\"}}");
    for (int j = 0; j < BODY_JOINTS; j++)
        text_add(t, ",{\"sampler\":%d,\"target\":{\"node\":%d,\"path\":\"rotation\"}}", 1 + j, j);
    text_add(t, "]}],");
}

static void accessors_text(const clip *k, text_builder *t) {
    const size_t f = (size_t)k->frames, column = f * sizeof(float);
    text_add(t, "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":%zu,\"type\":\"SCALAR\",",
             f);
    text_add(t, "\"min\":[0],\"max\":[%.9g]},", (double)(float)((double)(f - 1) / k->fps));
    text_add(t,
             "{\"bufferView\":0,\"byteOffset\":%zu,\"componentType\":5126,\"count\":%zu,\"type\":\"VEC3\"}",
             column, f);
    for (size_t j = 0; j < BODY_JOINTS; j++)
        text_add(
            t,
            ",{\"bufferView\":0,\"byteOffset\":%zu,\"componentType\":5126,\"count\":%zu,\"type\":\"VEC4\"}",
            (4 + 4 * j) * column, f);
    text_add(t, "],\"bufferViews\":[{\"buffer\":0,\"byteLength\":%zu}],\"buffers\":[{\"byteLength\":%zu}]}",
             (4 + 4 * BODY_JOINTS) * column, (4 + 4 * BODY_JOINTS) * column);
}

static sherf_status chunk_write(context *c, output_file *out, const char type[4], const void *data,
                                size_t bytes) {
    const uint32_t length = (uint32_t)bytes;
    sherf_status status = output_write(c, out, &length, sizeof length);
    if (!status) status = output_write(c, out, type, 4);
    return status ? status : output_write(c, out, data, bytes);
}

static sherf_status file_put(context *c, const char *path, const text_builder *t, const float *data,
                             size_t bytes) {
    output_file out = {0};
    const uint32_t head[3] = {0x46546c67, 2, (uint32_t)(12 + 8 + t->bytes + 8 + bytes)};
    sherf_status status = output_open(c, path, &out);
    if (!status) status = output_write(c, &out, head, sizeof head);
    if (!status) status = chunk_write(c, &out, "JSON", t->data, t->bytes);
    if (!status) status = chunk_write(c, &out, "BIN", data, bytes);
    if (!status) status = output_commit(c, &out);
    output_abort(&out);
    return status;
}

sherf_status motion_save_glb(context *c, const sherf_motion *motion, const char *path) {
    text_builder t = {.c = c};
    float *data = NULL;
    sherf_status status = bytes_make(c, &motion->clip, &data);
    text_add(&t,
             "{\"asset\":{\"version\":\"2.0\",\"generator\":\"sherf "
             "%s\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],",
             SHERF_VERSION);
    nodes_text(motion, &t);
    animation_text(&t);
    accessors_text(&motion->clip, &t);
    while (!t.failed && t.bytes % 4) text_add(&t, " ");
    if (!status && t.failed) status = SHERF_NO_MEMORY;
    if (!status)
        status =
            file_put(c, path, &t, data, (size_t)motion->clip.frames * (4 + 4 * BODY_JOINTS) * sizeof *data);
    mem_free(data);
    mem_free(t.data);
    return status;
}
