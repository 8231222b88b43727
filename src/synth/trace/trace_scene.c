/* Scenes: meshes, their poses, and Embree's BVH over them. */
#include <string.h>

#include "synth/trace/trace_inside.h"

enum { MESHES_MAX = 256 };
static const int64_t points_max = (int64_t)1 << 27;

static const char *error_text(enum RTCError error) {
    switch (error) {
    case RTC_ERROR_OUT_OF_MEMORY:
        return "out of memory";
    case RTC_ERROR_UNSUPPORTED_CPU:
        return "this processor is not supported";
    case RTC_ERROR_CANCELLED:
        return "cancelled";
    case RTC_ERROR_INVALID_ARGUMENT:
        return "invalid argument";
    case RTC_ERROR_INVALID_OPERATION:
        return "invalid operation";
    default:
        return "unknown error";
    }
}

/* The calling thread's newest error; device NULL: the error of creating one. */
static sherf_status check_device(context *c, RTCDevice device, const char *what) {
    enum RTCError error = rtcGetDeviceError(device);
    if (error == RTC_ERROR_NONE) return SHERF_OK;
    return failure(c, error == RTC_ERROR_OUT_OF_MEMORY ? SHERF_NO_MEMORY : SHERF_UNSUPPORTED,
                   "Embree: %s: %s", what, error_text(error));
}

sherf_status trace_scene_create(context *c, float spacing_m, trace_scene **out) {
    *out = NULL;
    if (!(spacing_m >= 0.001f && spacing_m <= 1))
        return failure(c, SHERF_BAD_ARGUMENT, "scene: light every %g m, must be 0.001 to 1", spacing_m);
    trace_scene *s = mem_zero(c, 1, sizeof *s);
    if (!s) return SHERF_NO_MEMORY;
    s->spacing_m = spacing_m;
    /* The calling thread builds the trees: people are made in parallel. */
    s->device = rtcNewDevice("threads=1,set_affinity=0");
    if (!s->device) {
        sherf_status status = check_device(c, NULL, "start");
        mem_free(s);
        return status ? status : failure(c, SHERF_UNSUPPORTED, "Embree does not start");
    }
    if (!rtcGetDeviceProperty(s->device, RTC_DEVICE_PROPERTY_RAY_MASK_SUPPORTED) ||
        !rtcGetDeviceProperty(s->device, RTC_DEVICE_PROPERTY_FILTER_FUNCTION_SUPPORTED)) {
        trace_scene_free(s);
        return failure(c, SHERF_UNSUPPORTED, "Embree: built without ray masks or filter functions");
    }
    *out = s;
    return SHERF_OK;
}

void trace_scene_free(trace_scene *s) {
    if (!s) return;
    if (s->scene) rtcReleaseScene(s->scene);
    if (s->device) rtcReleaseDevice(s->device);
    for (int i = 0; i < s->meshes; i++) scene_mesh_free(&s->mesh[i]);
    mem_free(s->mesh);
    mem_free(s->lit);
    mem_free(s->sky_sample);
    mem_free(s->lamp_sample);
    mem_free(s);
}

static sherf_status check_material(context *c, const trace_material *material) {
    bool fine = material->specular >= 0 && material->specular <= 1 && material->roughness >= 0 &&
                material->roughness <= 1 && material->cutoff >= 0 && material->cutoff <= 1 &&
                material->near_m >= 0 && material->near_m <= 1 && material->layer >= 0 &&
                material->layer <= 15;
    for (int k = 0; k < 3; k++)
        fine = fine && material->tint[k] >= 0 && material->tint[k] <= 100 && material->wrap[k] >= 0 &&
               material->wrap[k] <= 1;
    if (fine && material->alpha >= TRACE_OPAQUE && material->alpha <= TRACE_BLENDED) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "material: a value is out of range");
}

sherf_status trace_scene_add(context *c, trace_scene *s, const trace_mesh *mesh,
                             const trace_material *material) {
    if (s->scene || s->meshes >= MESHES_MAX)
        return failure(c, SHERF_BAD_ARGUMENT,
                       s->scene ? "scene: a mesh is added after the first pose" : "scene: too many meshes");
    sherf_status status = check_material(c, material);
    if (status != SHERF_OK) return status;
    scene_mesh *grown = mem_grow(c, s->mesh, (size_t)s->meshes, (size_t)s->meshes + 1, sizeof *grown);
    if (!grown) return SHERF_NO_MEMORY;
    s->mesh = grown;
    scene_mesh *added = &s->mesh[s->meshes];
    if ((status = scene_mesh_create(c, mesh, material, s->spacing_m, added))) return status;
    if (s->points + added->points > points_max) {
        scene_mesh_free(added);
        return failure(c, SHERF_BAD_ARGUMENT, "scene: light every %g m makes too many points", s->spacing_m);
    }
    added->points_before = s->points;
    s->points += added->points;
    if (material->layer > s->top_layer) s->top_layer = material->layer;
    s->meshes++;
    return SHERF_OK;
}

static void attach_mesh(trace_scene *s, scene_mesh *mesh) {
    RTCGeometry g = rtcNewGeometry(s->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, mesh->vertex, 0,
                               3 * sizeof *mesh->vertex, (size_t)mesh->vertices);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, mesh->face, 0,
                               3 * sizeof *mesh->face, (size_t)mesh->faces);
    rtcSetGeometryUserData(g, mesh);
    rtcSetGeometryMask(g, mesh->material.seen ? seen_mask(mesh->material.seen) : 1u << mesh->material.layer);
    if (memchr(mesh->solid, 0, (size_t)mesh->faces) || mesh->material.layer < s->top_layer)
        rtcSetGeometryOccludedFilterFunction(g, light_filter);
    rtcCommitGeometry(g);
    rtcAttachGeometry(s->scene, g);
    rtcReleaseGeometry(g);
}

/* Does everything that must wait for the last mesh. */
static sherf_status complete(context *c, trace_scene *s) {
    if (!s->meshes) return failure(c, SHERF_BAD_ARGUMENT, "scene: no mesh");
    if (!s->lit && !(s->lit = mem_alloc(c, (size_t)s->points, 2 * sizeof *s->lit))) return SHERF_NO_MEMORY;
    s->scene = rtcNewScene(s->device);
    if (!s->scene) return check_device(c, s->device, "scene");
    rtcSetSceneFlags(s->scene, RTC_SCENE_FLAG_ROBUST);
    for (int i = 0; i < s->meshes; i++) attach_mesh(s, &s->mesh[i]);
    sherf_status status = check_device(c, s->device, "meshes");
    if (status == SHERF_OK) return SHERF_OK;
    rtcReleaseScene(s->scene);
    s->scene = NULL;
    return status;
}

sherf_status trace_scene_pose(context *c, trace_scene *s, const float *const *positions,
                              const trace_light *light) {
    sherf_status status = light_prepare(c, s, light);
    if (status != SHERF_OK) return status;
    for (int i = 0; i < s->meshes; i++)
        for (int64_t v = 0; v < 3 * s->mesh[i].vertices; v++)
            if (!(fabsf(positions[i][v]) < 1e6f))
                return failure(c, SHERF_BAD_ARGUMENT, "scene: mesh %d, vertex %lld: not within 1000 km", i,
                               (long long)v / 3);
    bool first = !s->scene;
    for (int i = 0; i < s->meshes; i++) scene_mesh_pose(&s->mesh[i], positions[i]);
    if (first && (status = complete(c, s))) return status;
    for (int i = 0; i < s->meshes && !first; i++) {
        RTCGeometry g = rtcGetGeometry(s->scene, (unsigned)i);
        rtcUpdateGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0);
        rtcCommitGeometry(g);
    }
    rtcCommitScene(s->scene);
    light_forget(s);
    return check_device(c, s->device, "tree");
}
