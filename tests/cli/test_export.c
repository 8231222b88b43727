/* Tests of `sherf export`: files for other programs from an avatar file, and its error messages. */
#include "program.h"

#include <dirent.h>
#include <sys/resource.h>

#include "model/model.h"

static char folder[2048], avatar[2048], clip[2048], out[2048], words[6400];

/* Makes a tube person's avatar with a network whose density is 60 per metre everywhere. */
static int make_avatar(void **state) {
    context *c = test_context();
    sherf_model *m;
    char weights[2048];
    snprintf(folder, sizeof folder, "%s", test_path("tube"));
    snprintf(avatar, sizeof avatar, "%s", test_path("avatar.safetensors"));
    snprintf(clip, sizeof clip, "%s", test_path("turn.bvh"));
    snprintf(weights, sizeof weights, "%s", test_path("model.safetensors"));
    snprintf(out, sizeof out, "%s", test_path("out"));
    assert_int_equal(mkdir(out, 0777), 0);
    assert_ok(c, sherf_model_create(c, TINY, 3, &m));
    tensor *w = model_tensor(m, "decoder.alpha_linear.weight"),
           *b = model_tensor(m, "decoder.alpha_linear.bias");
    memset(w->data, 0, (size_t)tensor_count(w) * sizeof(float));
    *tensor_f32(b) = 60;
    assert_ok(c, sherf_model_save(c, m, weights));
    sherf_model_free(m);
    sherf_context_free(c);
    bvh_write(clip, 5);
    const outcome *o = run("synth tube -o %s --people 1 --poses 1 --views 4 --size 64 -q", folder);
    if (o->status) fail_msg("%s", o->err);
    o = run("avatar thuman:%s#0/0/0 -m %s -b %s/tubeman.safetensors -o %s -q", folder, weights, folder,
            avatar);
    if (o->status) fail_msg("%s", o->err);
    snprintf(words, sizeof words,
             "export %s -b %s/tubeman.safetensors -q --json -r 32 --triangles 400 --texture 128 --splats 300",
             avatar, folder);
    return 0;
}

/* The number of files in the folder `out`. */
static int files_there(void) {
    int count = 0;
    DIR *d = opendir(out);
    assert_non_null(d);
    for (const struct dirent *e; (e = readdir(d));) count += e->d_name[0] != '.' || strlen(e->d_name) > 2;
    closedir(d);
    return count;
}

/* The beginning of a file as text, without binary bytes. */
static const char *beginning(const char *name) {
    static char text[4096];
    char path[2200];
    snprintf(path, sizeof path, "%s/%s", out, name);
    FILE *f = fopen(path, "rb");
    if (!f) fail_msg("%s is not there", name);
    size_t n = fread(text, 1, sizeof text - 1, f);
    fclose(f);
    text[n] = 0;
    for (size_t i = 4; i < 20 && i < n; i++) /* a .glb's numbers */
        if (!memcmp(text, "glTF", 4) && !text[i]) text[i] = ' ';
    return text;
}

static void every_format_in_every_pose(void **state) {
    static const char *const poses[] = {"", "--pose canonical", "--pose observation"};
    for (size_t i = 0; i < COUNT_OF(poses); i++) {
        cJSON *json = json_of(run("%s -o %s/a.glb %s", words, out, poses[i]));
        assert_true(number(json, "triangles") >= 300 && number(json, "triangles") <= 400);
        assert_int_equal(number(json, "vertices"), number(json, "triangles") / 2 + 2);
        assert_true(number(json, "level_per_m") >= 1 && number(json, "charts") >= 1);
        cJSON_Delete(json);
        assert_memory_equal(beginning("a.glb"), "glTF", 4);
        assert_contains(beginning("a.glb"), "\"left_knee\"");

        json = json_of(run("%s -o %s/a.obj %s", words, out, poses[i]));
        cJSON_Delete(json);
        assert_contains(beginning("a.obj"), "\nmtllib a.mtl\n");
        assert_contains(beginning("a.mtl"), "map_Kd a.png\n");
        assert_memory_equal(beginning("a.png"), "\211PNG", 4);

        json = json_of(run("%s -o %s/a.ply --up z %s", words, out, poses[i]));
        assert_contains(beginning("a.ply"), "+Z up");
        assert_contains(beginning("a.ply"), "element face ");
        cJSON_Delete(json);

        json = json_of(run("%s -o %s/s.ply --format splats %s", words, out, poses[i]));
        assert_int_equal(number(json, "splats"), 300);
        assert_contains(beginning("s.ply"), "element vertex 300\n");
        assert_contains(beginning("s.ply"), "property float f_dc_0\n");
        cJSON_Delete(json);
    }
    assert_int_equal(files_there(), 6);
}

static void a_motion_goes_along(void **state) {
    const outcome *o = run("%s -o %s/a.glb --motion %s --fps 50 --vertex-colors", words, out, clip);
    cJSON *json = json_of(o);
    assert_int_equal(number(json, "charts"), 0);
    cJSON_Delete(json);
    char path[2200], *data;
    snprintf(path, sizeof path, "%s/a.glb", out);
    FILE *f = fopen(path, "rb");
    assert_non_null(f);
    data = calloc(1, 1 << 16);
    assert_non_null(data);
    fseek(f, 20, SEEK_SET); /* the JSON chunk */
    assert_true(fread(data, 1, (1 << 16) - 1, f) > 1000);
    fclose(f);
    assert_contains(data, "\"animations\"");
    assert_contains(data, "\"COLOR_0\"");
    free(data);
    /* a file's poses, by number */
    snprintf(path, sizeof path, "%s/poses.npz", out);
    o = run("animate -m %s -b %s/tubeman.safetensors --npz %s -q", clip, folder, path);
    if (o->status) fail_msg("%s", o->err);
    json = json_of(run("%s -o %s/p.ply --pose %s --frame 4", words, out, path));
    cJSON_Delete(json);
    assert_error(run("%s -o %s/none.ply --pose %s --frame 5", words, out, path), 1, "--frame 5", "5 poses");
}

static void what_cannot_be_is_said(void **state) {
    const int before = files_there();
    assert_error(run("%s", words), 2, "--output FILE is missing", "sherf export --help");
    assert_error(run("%s -o %s/x.glb --fps 30", words, out), 2, "--fps needs --motion",
                 "sherf export --help");
    assert_error(run("%s -o %s/x.glb -r 5", words, out), 2, "--resolution: '5'", "sherf export --help");
    assert_error(run("%s -o %s/x.glb --format fbx", words, out), 2, "'fbx' is none of",
                 "sherf export --help");
    assert_error(run("%s -o %s/x.stl", words, out), 1, "x.stl", ".glb, .obj or .ply");
    assert_error(run("%s -o %s/x.ply --motion %s", words, out, clip), 1, "x.ply", "into a .glb only");
    assert_error(run("%s -o %s/x.glb --up z", words, out), 1, "x.glb", "always has +Y up");
    assert_error(run("%s -o %s/x.glb --level 900000", words, out), 1, "level 900000", "nowhere that dense");
    assert_error(run("%s -o %s/x.glb --motion %s", words, out, avatar), 1, avatar,
                 "a sherf-avatar, not a motion");
    assert_error(run("%s -o %s/x.ply --pose /no/such/file", words, out), 1, "sherf: ", "/no/such/file");
    assert_error(run("%s -o /no/such/folder/x.glb", words), 1, "sherf: ", "/no/such/folder/x.glb");
    assert_error(run("%s -o /no/such/folder/x.obj", words), 1, "sherf: ", "/no/such/folder/x");
    assert_error(
        run("export %s/tubeman.safetensors -q -b %s/tubeman.safetensors -o %s/x.glb", folder, folder, out), 1,
        "sherf: ", "tubeman.safetensors");
    assert_int_equal(files_there(), before);
}

/* Every verb names the baked avatar that it cannot use. */
static void a_baked_avatar_is_named(void **state) {
    char baked[2100];
    snprintf(baked, sizeof baked, "%s", test_path("baked.safetensors"));
    const outcome *o = run("bake %s -b %s/tubeman.safetensors -o %s -q -r 32 --triangles 400 --texture 64",
                           avatar, folder, baked);
    if (o->status) fail_msg("%s", o->err);
    const int before = files_there();
    const long bytes = file_size(avatar);
    assert_error(run("bake %s -b %s/tubeman.safetensors -q -o %s", avatar, folder, avatar), 2, avatar,
                 "that is the input");
    assert_int_equal(file_size(avatar), bytes);
    assert_error(run("export %s -b %s/tubeman.safetensors -q -o %s/x.glb", baked, folder, out), 1, baked,
                 "an export needs the avatar that it was made from");
    assert_error(run("render %s -b %s/tubeman.safetensors -q --exact -o %s/x.png", baked, folder, out), 1,
                 baked, "exact frames need");
    assert_error(run("bake %s -b %s/tubeman.safetensors -q -o %s/x.safetensors", baked, folder, out), 1,
                 baked, "baked already");
    assert_int_equal(files_there(), before);
}

/* Files may not grow beyond a few KB, as on a full disk: nothing remains of them. */
static void no_room(void **state) {
    static const char *const names[] = {"y.glb", "y.obj", "y.ply", "y.ply --format splats"};
    const int before = files_there();
    struct rlimit limit, little;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &limit), 0);
    little = limit;
    little.rlim_cur = 6000;
    signal(SIGXFSZ, SIG_IGN); /* the program inherits this and gets an error like ENOSPC */
    for (size_t i = 0; i < COUNT_OF(names); i++) {
        assert_int_equal(setrlimit(RLIMIT_FSIZE, &little), 0);
        const outcome *o = run("%s -o %s/%s", words, out, names[i]);
        assert_int_equal(setrlimit(RLIMIT_FSIZE, &limit), 0);
        assert_error(o, 1, "sherf: ", "too large");
        assert_int_equal(files_there(), before);
    }
    signal(SIGXFSZ, SIG_DFL);
}

int main(void) {
    const char *program = getenv("SHERF_PROGRAM");
    if (!program || !*program) {
        puts("the program was not built");
        return 77;
    }
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_format_in_every_pose),
                                       cmocka_unit_test(a_motion_goes_along),
                                       cmocka_unit_test(what_cannot_be_is_said),
                                       cmocka_unit_test(a_baked_avatar_is_named), cmocka_unit_test(no_room)};
    return cmocka_run_group_tests(tests, make_avatar, NULL);
}
