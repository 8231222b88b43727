/* Tests of the program as a person or a script uses it: words, exit statuses, one-line errors, JSON. */
#include "program.h"

#include <glob.h>

#include "base/path.h"

static const char *const verbs[] = {"avatar", "estimate", "render", "animate", "bake",
                                    "view",   "export",   "train",  "eval",    "experiment",
                                    "synth",  "convert",  "check",  "info",    "bench"};

/* ---- words ---- */
static void version_and_help(void **state) {
    const outcome *o = run("--version");
    assert_int_equal(o->status, 0);
    assert_string_equal(o->out, "sherf " SHERF_VERSION "\n");
    o = run("--help");
    assert_int_equal(o->status, 0);
    for (size_t i = 0; i < COUNT_OF(verbs); i++) assert_contains(o->out, verbs[i]);
    for (size_t i = 0; i < COUNT_OF(verbs); i++) {
        o = run("%s --help", verbs[i]);
        assert_int_equal(o->status, 0);
        assert_string_equal(o->err, "");
        char line[64];
        snprintf(line, sizeof line, "usage: sherf %s", verbs[i]);
        assert_contains(o->out, line);
        snprintf(line, sizeof line, "\nexample\n  sherf %s", verbs[i]);
        assert_contains(o->out, line);
        assert_contains(o->out, "--precision auto|fp32|bf16");
        o = run("%s --version", verbs[i]);
        assert_string_equal(o->out, "sherf " SHERF_VERSION "\n");
    }
}

/* Every long option in the help is in the manual page and in both completions. */
static void texts_agree(void **state) {
    static char bash[TEXT_MAX], zsh[TEXT_MAX], help[TEXT_MAX];
    strcpy(bash, run("--describe bash")->out);
    strcpy(zsh, run("--describe zsh")->out);
    int options = 0;
    for (size_t i = 0; i < COUNT_OF(verbs); i++) {
        strcpy(help, run("%s --help", verbs[i])->out);
        const outcome *man = run("--describe man-%s", verbs[i]);
        assert_int_equal(man->status, 0);
        for (const char *p = help; (p = strstr(p, "--")); p++) {
            char name[64] = "--", escaped[128] = "";
            size_t n = strspn(p + 2, "abcdefghijklmnopqrstuvwxyz-");
            if (n == 0 || n > 40) continue;
            memcpy(name + 2, p + 2, n);
            assert_contains(bash, name);
            assert_contains(zsh, name);
            for (const char *q = name; *q; q++) strcat(escaped, *q == '-' ? "\\-" : (char[]){*q, 0});
            assert_contains(man->out, escaped);
            options++;
        }
    }
    assert_true(options > 100);
}

static void wrong_usage(void **state) {
    const outcome *o = run("");
    assert_int_equal(o->status, 2);
    assert_contains(o->err, "usage: sherf VERB");
    assert_error(run("dance"), 2, "'dance'", "sherf --help");
    assert_error(run("--threads 2 info x"), 2, "'--threads'", "sherf --help");
    assert_error(run("convert a b -o c"), 2, "'b'", "sherf convert --help");
    assert_error(run("convert -o c"), 2, "FILE is missing", "sherf convert --help");
    assert_error(run("convert a"), 2, "--output FILE is missing", "sherf convert --help");
    assert_error(run("convert a -o"), 2, "-o wants a value", "sherf convert --help");
    assert_error(run("convert a --output"), 2, "--output wants a value", "sherf convert --help");
    assert_error(run("convert a --output="), 2, "--output", "sherf convert --help");
    assert_error(run("convert a -o b --fast"), 2, "--fast", "sherf convert --help");
    assert_error(run("convert a -o b -x"), 2, "-x", "sherf convert --help");
    assert_error(run("convert a -o b --json=1"), 2, "--json takes no value", "sherf convert --help");
    assert_error(run("info x --precision fp16"), 2, "'fp16' is none of auto|fp32|bf16", "sherf info --help");
    assert_error(run("info x --threads two"), 2, "--threads: 'two'", "sherf info --help");
    assert_error(run("info x --threads -1"), 2, "--threads: '-1'", "sherf info --help");
    assert_error(run("info x --threads 9999999999999999999999"), 2, "--threads", "sherf info --help");
    assert_error(run("bench nothing"), 2, "'nothing' is none of render|avatar|train|export|bake",
                 "sherf bench --help");
    assert_error(run("synth cube -o x"), 2, "'cube'", "sherf synth --help");
    assert_error(run("avatar a.jpg b.jpg -o c.safetensors --mask d.png"), 2, "--mask is for one photo",
                 "sherf avatar --help");
    assert_error(run("avatar 1 2 3 4 5 6 7 8 9 -o c.safetensors"), 2, "'9' is one argument too many",
                 "sherf avatar --help");
    const char *eval = "eval -d a -m b -b c";
    assert_error(run("%s --pictures 9", eval), 2, "--pictures: '9'", "sherf eval --help");
    assert_error(run("%s --observation 4", eval), 2, "--observation: '4'", "sherf eval --help");
    assert_error(run("%s --views 0,,2", eval), 2, "--views: '0,,2'", "sherf eval --help");
    assert_error(run("%s --poses 0:1", eval), 2, "--poses: '0:1'", "sherf eval --help");
    assert_error(run("%s --npy", eval), 2, "--npy needs --output", "sherf eval --help");
    const char *render = "render a.safetensors -b b -o c";
    assert_error(run("%s --size 0", render), 2, "--size: '0'", "sherf render --help");
    assert_error(run("%s --size 10x", render), 2, "--size: '10x'", "sherf render --help");
    assert_error(run("%s --fov nan", render), 2, "--fov: 'nan'", "sherf render --help");
    assert_error(run("%s --background 1,2,3", render), 2, "--background: '1,2,3'", "sherf render --help");
    assert_error(run("%s.mp4 --background transparent", render), 2, "transparent", "sherf render --help");
    assert_error(run("%s --orbit 3 --cameras f", render), 2, "exclude", "sherf render --help");
    assert_error(run("%s --views 1", render), 2, "--data", "sherf render --help");
    assert_error(run("%s --poses 0,1", render), 2, "--poses", "sherf render --help");
    const char *animate = "animate a.safetensors -m b -b c";
    assert_error(run("animate a.safetensors -o b"), 2, "--motion FILE|FOLDER is missing",
                 "sherf animate --help");
    assert_error(run("%s", animate), 2, "--output OUT is missing", "sherf animate --help");
    assert_error(run("animate -m b -b c -o d"), 2, "INPUT is missing", "sherf animate --help");
    assert_error(run("%s -a d -o e", animate), 2, "twice", "sherf animate --help");
    assert_error(run("%s -o e.mp4 --background transparent", animate), 2, "transparent",
                 "sherf animate --help");
    assert_error(run("%s -o e --camera hand", animate), 2, "'hand' is none of fixed|follow|orbit|observation",
                 "sherf animate --help");
    assert_error(run("%s -o e --first 5 --last 3", animate), 2, "--last", "sherf animate --help");
    assert_error(run("view -b b"), 2, "INPUT... is missing", "sherf view --help");
    assert_error(run("view a.safetensors --port 65536"), 2, "--port: '65536'", "sherf view --help");
    assert_error(run("check a --overlay b.png"), 2, "--overlay needs --body", "sherf check --help");
}

/* Unsupported file extensions, and standard output. */
static void outputs_are_checked(void **state) {
    static const char *const endings[] = {"avi", "mkv", "tiff", "MPEG", "v2"};
    for (size_t i = 0; i < COUNT_OF(endings); i++) {
        assert_error(run("render a.safetensors -b b -o c.%s", endings[i]), 2, "is not written here", ".webm");
        assert_error(run("animate a.safetensors -m b -b c -o d.%s", endings[i]), 2, "is not written here",
                     "folder");
    }
    assert_error(run("animate a.safetensors -m b -b c -o d.png"), 2, "one picture", "sherf animate --help");
    assert_error(run("render a.safetensors -b b -o c.jpg --background transparent"), 2,
                 ".jpg has no transparency", ".png and .webp");
    assert_error(run("render a.safetensors -b b -o - --json"), 2, "standard output", "sherf render --help");
    assert_error(run("export a.safetensors -b b -o -"), 2, "standard output", "sherf export --help");
    assert_error(run("avatar a -o b.png"), 2, "no .png is written here", ".safetensors");
    assert_error(run("convert a -o b.pkl"), 2, "no .pkl is written here", ".safetensors");
    assert_error(run("eval -d a -m b -b c -o d.json"), 2, "no .json is written here", "put / behind it");
    assert_error(run("estimate a.jpg -o b.png"), 2, "b.png/", "sherf estimate --help");
}

/* A copied program, run from a folder without assets, and then with assets next to it. */
static void assets_beside_the_program(void **state) {
    const char *own = getenv("SHERF_PROGRAM");
    char bin[2048], program[2100], share[2100], here[4096], was[4096], assets[4200];
    snprintf(bin, sizeof bin, "%s", test_path("moved/bin"));
    snprintf(program, sizeof program, "%s/sherf", bin);
    snprintf(share, sizeof share, "%s", test_path("moved/share"));
    snprintf(was, sizeof was, "%s", own);
    assert_non_null(getcwd(here, sizeof here));
    snprintf(assets, sizeof assets, "%s/../assets", here);
    context *c = test_context();
    assert_ok(c, folder_make(c, bin));
    assert_ok(c, folder_make(c, share));
    unsigned char *data;
    size_t bytes;
    assert_ok(c, file_read(c, own, (size_t)1 << 30, &data, &bytes));
    FILE *f = fopen(program, "wb");
    assert_int_equal(fwrite(data, 1, bytes, f), bytes);
    fclose(f);
    mem_free(data);
    assert_int_equal(chmod(program, 0755), 0);
    setenv("SHERF_PROGRAM", program, 1);
    assert_int_equal(chdir(bin), 0);
    assert_error(run("animate -m /no/such/file --npz x.npz"), 2,
                 "no body.safetensors among the assets (looked in", "moved/bin/../share/sherf");
    assert_error(run("render a.json -b %s/body.safetensors -q -o c", assets), 2, "--model FILE is missing",
                 "moved/bin/../assets");
    strcat(share, "/sherf");
    assert_int_equal(symlink(assets, share), 0);
    assert_error(run("animate -q -m /no/such/file --npz x.npz"), 1, "sherf: ", "/no/such/file");
    assert_int_equal(chdir(here), 0);
    setenv("SHERF_PROGRAM", was, 1);
    sherf_context_free(c);
}

static void what_is_missing_or_broken(void **state) {
    assert_error(run("info /no/such/file"), 1, "sherf: ", "/no/such/file");
    assert_error(run("convert /no/such/file -o x"), 1, "sherf: ", "/no/such/file");
    const outcome *o = run("check /no/such/file"); /* finding such faults is its task */
    assert_int_equal(o->status, 1);
    assert_contains(o->out, "error: /no/such/file");
    assert_error(run("avatar a -m b -b /no/such/file -o x"), 1, "sherf: ", "/no/such/file");
    assert_error(run("render a -b /no/such/file -o x"), 1, "sherf: ", "/no/such/file");
    assert_error(run("eval -d /no/such/data -m b -b c"), 1, "sherf: ", "/no/such/data");
    assert_error(run("train -d /no/such/data -b c -o %s", test_path("run")), 1, "sherf: ", "/no/such/");
    static const char *const none[] = {"steps",        "epochs",     "seconds",      "batch",   "targets",
                                       "pictures",     "beta2",      "halve-every",  "workers", "size",
                                       "sample-every", "save-every", "learning-rate"};
    for (size_t i = 0; i < COUNT_OF(none); i++) /* 0 is not the default */
        assert_error(run("train -d a -b c --%s 0 -o %s", none[i], test_path("run")), 2, none[i],
                     "'0' is not in ");
    assert_error(run("animate -m a --last 0 -o b.mp4"), 2, "--last: '0' is not in 1", "--help");
    assert_error(run("synth body -o x"), 2, "--source", "sherf synth --help");
    assert_error(run("synth body -s 64 -o x"), 2, "body has no --size", "synth --help");
    assert_error(run("synth tube --sheet x.png -o x"), 2, "tube has no --sheet", "synth --help");
    assert_error(run("synth tube -n 1000001 -o x"), 2, "not in 1 to 1000000 ", "synth --help");
    assert_error(run("synth body --source /no/such/folder -o x"), 1, "sherf: ", "/no/such/folder");
    assert_error(run("synth tube -o /proc/no/such"), 1, "sherf: ", "/proc/no");
    char no_gpu[256];
    if (sherf_device_find(SHERF_DEVICE_CUDA, no_gpu, sizeof no_gpu) != SHERF_OK)
        assert_error(run("info x --device cuda"), 1, "sherf: --device cuda: ", no_gpu);
    const char *junk = test_path("junk.safetensors");
    text_write(junk, "this is nothing that anybody knows");
    assert_error(run("convert %s -o %s", junk, test_path("none")), 1, "sherf: ", "junk.safetensors");
    assert_error(run("render x -b %s -o y", junk), 1, "sherf: ", "junk.safetensors");
    assert_int_equal(file_size(test_path("none")), -1);
}

static void bench_answers(void **state) {
    cJSON *json = json_of(run("bench render --preset " TINY " --size 48 --repeats 1 --json"));
    assert_true(number(json, "frame_ms") > 0);
    assert_true(number(json, "exact_frame_ms") > 0);
    assert_true(number(json, "default_frame_ms") > 0);
    assert_true(number(json, "avatar_ms") > 0);
    assert_true(number(json, "points") > 0);
    assert_true(number(json, "fma_gflops") > 0);
    const cJSON *shares = cJSON_GetObjectItem(json, "share_of_peak");
    assert_true(number(shares, "convolutions") > 0);
    assert_true(number(shares, "network") > 0);
    assert_true(number(json, "peak_rss_mb") > 0);
    assert_true(cJSON_IsString(cJSON_GetObjectItem(json, "precision")));
    cJSON_Delete(json);
    json = json_of(run("bench train --preset " TINY " --size 64 --repeats 1 --json"));
    assert_true(number(json, "step_ms") > 0);
    cJSON_Delete(json);
    json = json_of(run("bench bake --preset " TINY " --size 64 --repeats 1 --json"));
    assert_true(number(json, "bake_ms") > 0 && number(json, "baked_frame_ms") > 0);
    cJSON_Delete(json);
}

/* ---- from a data set to frames ---- */
static void make_model(const char *path) {
    context *c = test_context();
    sherf_model *model;
    assert_ok(c, sherf_model_create(c, TINY, 1, &model));
    assert_ok(c, sherf_model_save(c, model, path));
    sherf_model_free(model);
    sherf_context_free(c);
}

/* Width and height of a PNG, from its header. */
static void assert_png(const char *path, unsigned width, unsigned height) {
    unsigned char b[24];
    FILE *f = fopen(path, "rb");
    if (!f) fail_msg("%s: is not there", path);
    assert_int_equal(fread(b, 1, sizeof b, f), sizeof b);
    fclose(f);
    assert_memory_equal(b, "\211PNG", 4);
    assert_int_equal((unsigned)b[18] << 8 | b[19], width);
    assert_int_equal((unsigned)b[22] << 8 | b[23], height);
}

/* The viewer prints its address, accepts motions and poses, and exits with 0 on an interrupt. */
static void viewer_by_itself(const char *folder, const char *avatar) {
    char words[7000], out[512], err[512];
    static char text[TEXT_MAX], said[TEXT_MAX];
    snprintf(out, sizeof out, "%s", test_path("view.out"));
    snprintf(err, sizeof err, "%s", test_path("view.err"));
    snprintf(words, sizeof words, "view %s %s -b %s/tubeman.safetensors", avatar, avatar, folder);
    const outcome *o = run("%s --motion /no/such/file", words);
    if (strstr(o->err, "libmicrohttpd")) return; /* a build without the viewer */
    assert_error(run("%s -q --motion /no/such/file", words), 1, "sherf: ", "/no/such/file");
    assert_error(run("%s -q --listen nowhere", words), 1, "sherf: ", "nowhere");
    pid_t child = start(words, out, err);
    int status = 0;
    pid_t ended = 0;
    for (int i = 0; i < 1200 && !ended; i++) {
        usleep(50000);
        text_read(out, text);
        if (strchr(text, '\n')) break;
        ended = waitpid(child, &status, WNOHANG);
    }
    text_read(err, said);
    if (!ended) kill(child, SIGINT);
    for (int i = 0; i < 1200 && !ended; i++) {
        usleep(50000);
        ended = waitpid(child, &status, WNOHANG);
    }
    if (!ended) kill(child, SIGKILL);
    if (strstr(said, "libmicrohttpd")) return;
    int port, used = 0;
    if (sscanf(text, "http://127.0.0.1:%d/%*32[0-9a-f]/%n", &port, &used) != 1 || text[used] != '\n' ||
        text[used + 1])
        fail_msg("no address: '%s', %s", text, said);
    if (ended != child || !WIFEXITED(status) || WEXITSTATUS(status))
        fail_msg("status %x: %s", (unsigned)status, said);
}

/* Without --body and --perceptual both come from the asset folder; here the second file is another network.
 */
static void assets_by_themselves(const char *folder, const char *model) {
    char assets[2048], body[2100], resnet50[2100], own_body[2100];
    snprintf(assets, sizeof assets, "%s", test_path("assets"));
    snprintf(body, sizeof body, "%s/body.safetensors", assets);
    snprintf(resnet50, sizeof resnet50, "%s/resnet50.safetensors", assets);
    snprintf(own_body, sizeof own_body, "%s/tubeman.safetensors", folder);
    assert_int_equal(mkdir(assets, 0777), 0);
    assert_int_equal(rename(own_body, body), 0);
    assert_int_equal(symlink(model, resnet50), 0);
    setenv("SHERF_ASSETS", assets, 1);
    assert_error(run("eval -q -d thuman:%s -m %s --people 0", folder, model), 1, "/resnet50.safetensors",
                 "conv1.weight is missing");
    const outcome *o =
        run("eval -q -d thuman:%s -m %s --people 0 --perceptual none --observation 0:0 --poses 0 "
            "--views 1",
            folder, model);
    if (o->status) fail_msg("%s", o->err);
    setenv("SHERF_ASSETS", "/nowhere", 1);
    o = run("avatar nothing.jpg -o %s.safetensors", folder);
    assert_contains(o->err, "SHERF_ASSETS: there is no folder /nowhere");
    unsetenv("SHERF_ASSETS");
    assert_int_equal(rename(body, own_body), 0);
}

/* Without --body, the body in the data set's folder is used, with a remark. */
static void avatars_without_body(const char *folder, const char *person, const char *model,
                                 const char *avatar) {
    char sheet[2100];
    const outcome *several = run("avatar thuman:%s#%s/0/1 thuman:%s#%s/1/0 -m %s -o %s.2 --variants 1",
                                 folder, person, folder, person, model, avatar);
    assert_int_equal(several->status, 0);
    snprintf(sheet, sizeof sheet, "%s-variants.png", avatar);
    assert_contains(several->err, sheet);
    assert_true(file_size(sheet) > 1000);
    several = run("info %s.2", avatar);
    assert_contains(several->out, "an avatar of several pictures");
    assert_contains(several->out, "variant      0\n");
    cJSON *json = json_of(run("avatar thuman:%s#%s/0/1 -m %s -o %s.2 --variant 7 --variants 1 --json", folder,
                              person, model, avatar));
    assert_string_equal(cJSON_GetObjectItem(json, "variants")->valuestring, sheet);
    cJSON_Delete(json);
    json = json_of(run("info %s.2 --json", avatar));
    assert_string_equal(cJSON_GetObjectItem(json, "variant")->valuestring, "7");
    cJSON_Delete(json);
    several = run("render %s.2 -b %s/tubeman.safetensors -o %s.2.png -s 32", avatar, folder, avatar);
    assert_int_equal(several->status, 0);
    const outcome *by_itself = run("avatar thuman:%s#%s/0/1 -m %s -o %s", folder, person, model, avatar);
    if (by_itself->status) fail_msg("%s", by_itself->err);
    assert_contains(by_itself->err, "/tubeman.safetensors");
}

/* A full disk: one line, and nothing of the picture or the video remains. */
static void full_disk(const char *render, const char *out) {
    static const char *const kinds[] = {".png", ".mp4 --orbit 2"};
    char pattern[2100];
    glob_t found;
    snprintf(pattern, sizeof pattern, "%s-full*", out);
    file_bytes_max = 1100; /* LLVM's OpenMP ends programs that cannot create a shared file of 1024 bytes */
    for (size_t i = 0; i < COUNT_OF(kinds); i++) {
        const outcome *o = run("%s -o %s-full%s --size 96 -q", render, out, kinds[i]);
        assert_int_equal(o->status, 1);
        assert_contains(o->err, "cannot be written");
        assert_int_equal(glob(pattern, 0, NULL, &found), GLOB_NOMATCH);
        globfree(&found);
    }
    file_bytes_max = 0;
}

static void frames_of(const char *folder, const char *person, const char *avatar) {
    char render[6000], out[2048], path[2100];
    snprintf(render, sizeof render, "render %s -q -b %s/tubeman.safetensors", avatar, folder);
    snprintf(out, sizeof out, "%s", test_path("out"));
    /* The picture's own camera and pose, then an orbit with all options, then the data set's poses and
     * cameras. */
    const outcome *o = run("%s -o - -q", render);
    if (o->status) fail_msg("%s", o->err);
    assert_memory_equal(o->out, "\x89PNG\r\n\x1a\n", 8);
    o = run("%s -o %s.jpg", render, out);
    assert_int_equal(o->status, 0);
    o = run("%s -o %s.png --background transparent", render, out);
    if (o->status) fail_msg("%s", o->err);
    snprintf(path, sizeof path, "%s.png", out);
    assert_png(path, 64, 64);
    cJSON *json =
        json_of(run("%s -o %s --orbit 3 --size 48x32 --depth --opacity --npy --strip %s/strip.png --json",
                    render, out, out));
    assert_int_equal(number(json, "frames"), 3);
    assert_true(number(json, "points") > 0); /* the orbit shows the body */
    cJSON_Delete(json);
    const char *const names[] = {"frame_0000.png", "frame_0002.png", "depth_0001.png", "opacity_0002.png"};
    for (size_t i = 0; i < COUNT_OF(names); i++) {
        snprintf(path, sizeof path, "%s/%s", out, names[i]);
        assert_png(path, 48, 32);
    }
    snprintf(path, sizeof path, "%s/strip.png", out);
    assert_png(path, 3 * 48, 32);
    snprintf(path, sizeof path, "%s/depth_0002.npy", out);
    assert_int_equal(file_size(path), 128 + 48 * 32 * 4);
    json = json_of(
        run("%s -o %s.mp4 --data thuman:%s --people %s --views 0,2 --poses 0:1:2 --every --size 32 --npy "
            "--json",
            render, out, folder, person));
    assert_int_equal(number(json, "frames"), 4);
    cJSON_Delete(json);
    snprintf(path, sizeof path, "%s.mp4", out);
    assert_true(file_size(path) > 200);
    for (int i = 0; i < 4; i++) { /* one array per frame */
        snprintf(path, sizeof path, "%s_%04d.npy", out, i);
        assert_int_equal(file_size(path), 128 + 32 * 32 * 3 * 4);
    }
    assert_error(run("%s -o %s.png --orbit 2", render, out), 2, "2 frames", "--strip");
    assert_error(run("%s -o %s --data thuman:%s --people nobody", render, out, folder), 1, "nobody", folder);
    full_disk(render, out);
}

static void from_data_to_frames(void **state) {
    char folder[2048], model[2048], avatar[2048];
    snprintf(folder, sizeof folder, "%s", test_path("tube"));
    snprintf(model, sizeof model, "%s", test_path("model.safetensors"));
    snprintf(avatar, sizeof avatar, "%s", test_path("avatar.safetensors"));
    cJSON *json = json_of(run("synth tube -o %s --people 1 --poses 2 --views 4 --size 64 --json", folder));
    assert_int_equal(number(json, "pictures"), 8);
    cJSON_Delete(json);
    make_model(model);
    json = json_of(run("info %s --json", model));
    cJSON_Delete(json);

    context *c = test_context();
    sherf_dataset *d;
    assert_ok(c, sherf_dataset_open(c, folder, &d));
    char person[256];
    snprintf(person, sizeof person, "%s", sherf_dataset_person(d, 0));
    sherf_dataset_free(d);
    sherf_context_free(c);

    json = json_of(run("check thuman:%s --body %s/tubeman.safetensors --json", folder, folder));
    assert_int_equal(number(json, "errors"), 0);
    assert_true(cJSON_IsArray(cJSON_GetObjectItem(json, "findings")));
    cJSON_Delete(json);
    assert_contains(run("check thuman:%s", folder)->out,
                    "the body covers the mask"); /* the body in the folder */
    json = json_of(run("avatar thuman:%s#%s/0/1 -m %s -b %s/tubeman.safetensors -o %s --json", folder, person,
                       model, folder, avatar));
    assert_true(number(json, "bytes") == file_size(avatar));
    cJSON_Delete(json);

    avatars_without_body(folder, person, model, avatar);
    assets_by_themselves(folder, model);

    frames_of(folder, person, avatar);
    viewer_by_itself(folder, avatar);
}

static void animations(void **state) {
    char folder[2048], avatar[2048], clip[2048], out[2048], words[6400], path[2100], log[2048];
    snprintf(folder, sizeof folder, "%s", test_path("tube"));
    snprintf(avatar, sizeof avatar, "%s", test_path("avatar.safetensors"));
    snprintf(clip, sizeof clip, "%s", test_path("turn.bvh"));
    snprintf(out, sizeof out, "%s", test_path("turn"));
    snprintf(words, sizeof words, "animate %s -b %s/tubeman.safetensors -m %s", avatar, folder, clip);
    bvh_write(clip, 8);
    cJSON *json = json_of(run(
        "%s -o %s.webm --size 32 --background transparent --blend 0.2 --npz %s.npz --json", words, out, out));
    assert_int_equal(number(json, "frames"), 13);
    assert_float_equal(number(json, "fps"), 25, 1e-6);
    assert_true(number(json, "points") > 0); /* the person is in the picture */
    assert_contains(cJSON_GetObjectItem(json, "motion")->valuestring, "names of SMPL");
    cJSON_Delete(json);
    snprintf(path, sizeof path, "%s.webm", out);
    assert_true(file_size(path) > 200);
    json = json_of(run("animate -m %s.npz -b %s/tubeman.safetensors --fps 50 --npz %s2.npz --json", out,
                       folder, out)); /* the motion alone, written and read again */
    assert_int_equal(number(json, "frames"), 25);
    cJSON_Delete(json);
    const outcome *o = run("%s -a -o", words);
    assert_int_equal(o->status, 2);
    assert_error(run("%s -m %s -o %s.mp4 -q", words, avatar, out), 1, avatar, "not a motion");

    /* Ctrl-C leaves a complete file of the frames so far. */
    bvh_write(clip, 20000);
    snprintf(path, sizeof path, "%s.mp4", out);
    snprintf(log, sizeof log, "%s", test_path("log"));
    snprintf(words + strlen(words), sizeof words - strlen(words), " -o %s --size 32 -q", path);
    pid_t child = start(words, log, log);
    char part[2200];
    snprintf(part, sizeof part, "%s.%ld.part", path, (long)child);
    for (int i = 0; i < 1200 && file_size(part) <= 0; i++) usleep(50000);
    usleep(500000);
    kill(child, SIGINT);
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    static char text[TEXT_MAX];
    text_read(log, text);
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 1) fail_msg("status %x: %s", (unsigned)status, text);
    assert_contains(text, "stopped after");
    assert_int_equal(file_size(part), -1);
    assert_int_equal(strstr(text, "after 0 of") == NULL, file_size(path) > 200);
}

/* The first Ctrl-C ends a training cleanly, with a checkpoint. */
static void interrupt_saves(void **state) {
    char folder[2048], out[2048], log[2048], words[6400], checkpoint[2100];
    snprintf(folder, sizeof folder, "%s", test_path("tube"));
    snprintf(out, sizeof out, "%s", test_path("run"));
    snprintf(log, sizeof log, "%s", test_path("log"));
    snprintf(checkpoint, sizeof checkpoint, "%s/checkpoint.safetensors", out);
    snprintf(words, sizeof words,
             "train -d thuman:%s --people 0-0 -b %s/tubeman.safetensors --preset " TINY
             " --size 64 --steps 100000 "
             "--batch 1 -o %s",
             folder, folder, out);
    char steps[2100];
    snprintf(steps, sizeof steps, "%s/log.jsonl", out);
    pid_t child = start(words, log, log);
    int status = 0;
    pid_t ended = 0;
    for (int i = 0; i < 1200 && file_size(steps) <= 0 && !ended; i++) {
        usleep(50000);
        ended = waitpid(child, &status, WNOHANG);
    }
    if (!ended) kill(child, SIGINT);
    for (int i = 0; i < 1200 && !ended; i++) {
        usleep(50000);
        ended = waitpid(child, &status, WNOHANG);
    }
    if (!ended) kill(child, SIGKILL);
    static char text[TEXT_MAX];
    text_read(log, text);
    if (ended != child || !WIFEXITED(status)) fail_msg("did not end by itself: %s", text);
    if (file_size(checkpoint) <= 0) fail_msg("no checkpoint, status %d: %s", WEXITSTATUS(status), text);
}

/* --last-weights changes the weights in model.safetensors, and nothing else in the training. */
static void last_weights_are_others(void **state) {
    char folder[2048], out[2][2048], name[4200];
    unsigned char *data[2][2];
    size_t bytes[2][2];
    static const char *const file[2] = {"checkpoint", "model"};
    context *c = NULL;
    assert_int_equal(sherf_context_create(NULL, &c), SHERF_OK);
    snprintf(folder, sizeof folder, "%s", test_path("last-tube"));
    assert_int_equal(run("synth tube -o %s --people 1 --poses 2 --views 4 --size 64 -q", folder)->status, 0);
    for (int k = 0; k < 2; k++) {
        snprintf(out[k], sizeof out[k], "%s", test_path(k ? "last" : "mean"));
        assert_int_equal(run("train -d thuman:%s --people 0-0 -b %s/tubeman.safetensors --preset " TINY
                             " --size 64 --steps 3 --batch 1 --perceptual none -q -o %s%s",
                             folder, folder, out[k], k ? " --last-weights" : "")
                             ->status,
                         0);
        for (int i = 0; i < 2; i++) {
            snprintf(name, sizeof name, "%s/%s.safetensors", out[k], file[i]);
            assert_int_equal(file_read(c, name, (size_t)1 << 30, &data[k][i], &bytes[k][i]), SHERF_OK);
        }
    }
    for (int i = 0; i < 2; i++) {
        assert_int_equal(bytes[0][i], bytes[1][i]);
        const int other = memcmp(data[0][i], data[1][i], bytes[0][i]);
        if ((other != 0) != i) fail_msg("%s.safetensors is %s", file[i], other ? "another" : "the same");
        for (int k = 0; k < 2; k++) mem_free(data[k][i]);
    }
    /* the same command again; then from the front, of people with few views */
    static const char *const options[] = {"--steps 3", "--steps 4 --start other.safetensors"};
    static const char *const says[] = {
        "nothing is left to train: step 3 is done",
        "going on after step 3; other.safetensors is of use for a new training only"};
    for (int i = 0; i < 2; i++) {
        const outcome *o =
            run("train -d thuman:%s --people 0-0 -b %s/tubeman.safetensors --size 64 --batch 1 "
                "--perceptual none %s -o %s",
                folder, folder, options[i], out[0]);
        assert_int_equal(o->status, 0);
        assert_contains(o->err, says[i]);
        assert_contains(o->err, "model.safetensors: the model");
    }
    char words[6400], sheet[2048];
    assert_error(run("train -d thuman:%s -P 0 -b %s/tubeman.safetensors --start %s/model.safetensors -p "
                     "small -q -o %s",
                     folder, folder, out[0], test_path("begun")),
                 1, "not sherf:small", "leave the preset out to go on with these weights");
    snprintf(sheet, sizeof sheet, "%s", test_path("sheet.jpg"));
    snprintf(words, sizeof words,
             "eval -d thuman:%s -b %s/tubeman.safetensors --observation 0:0 --poses 0 --views 1", folder,
             folder);
    assert_error(run("%s -q --people 0:1 -m %s/model.safetensors", words, out[0]), 1, "no person \"0:1\"",
                 "lines such as 0-0");
    assert_error(run("%s -q -P 0 -m %s/checkpoint.safetensors", words, out[0]), 1,
                 "checkpoint.safetensors: a checkpoint of a training, not a model", "give model.safetensors");
    assert_error(run("%s -q -P 0 --sheet %s", words, sheet), 2, sheet, "should end in .png");
    snprintf(name, sizeof name, "%s", test_path("no-sheet"));
    assert_int_equal(
        run("%s -q -P 0 -m %s/model.safetensors --sheet /no/such/x.png -o %s", words, out[0], name)->status,
        1);
    assert_int_equal(access(name, F_OK), -1); /* it failed before the first picture */
    const outcome *o = run("%s -P 0 -m %s/model.safetensors --surfaces --perceptual none", words, out[0]);
    assert_int_equal(o->status, 0);
    assert_contains(o->err, "no surfaces are compared: the data set has none");
    o = run("train -d thuman:%s --people 0-0 -b %s/tubeman.safetensors --preset " TINY
            " --size 64 --batch 1 --perceptual none --steps 1 --front-view -o %s",
            folder, folder, test_path("front"));
    assert_int_equal(o->status, 0);
    assert_contains(o->err, "has 4 views: view 2 is taken for the front view");
    sherf_context_free(c);
}

/* A photo instead of an observation, and as a folder to correct; each photo fails separately. */
static void photos(void **state) {
    const char *const photo = "../assets/demo/photo.jpg", *const back = "../assets/demo/photo-back.jpg";
    char text[2048], out[2100], avatar[2048], overlay[2048], folder[2048];
    setenv("SHERF_ASSETS", "../assets", 1);
    snprintf(text, sizeof text, "%s", test_path("text.jpg"));
    snprintf(out, sizeof out, "%s", test_path("one"));
    snprintf(avatar, sizeof avatar, "%s", test_path("photo.safetensors"));
    snprintf(overlay, sizeof overlay, "%s", test_path("overlay.png"));
    const outcome *o = run("avatar %s -o %s --overlay %s", photo, avatar, overlay);
    assert_int_equal(o->status, 0);
    assert_contains(o->err, "photo.jpg: one person, 9");
    assert_true(file_size(avatar) > 1e6 && file_size(overlay) > 1e5);
    cJSON *json = json_of(run("estimate %s -o %s --json", photo, out));
    const cJSON *said = cJSON_GetArrayItem(json, 0);
    assert_int_equal(cJSON_GetArraySize(json), 1);
    assert_string_equal(cJSON_GetStringValue(cJSON_GetObjectItem(said, "observation")), out);
    assert_true(number(said, "person_px") > 800);
    assert_int_equal(cJSON_GetArraySize(cJSON_GetObjectItem(said, "warnings")), 0);
    cJSON_Delete(json);
    assert_int_equal(run("check %s -b ../assets/body.safetensors", out)->status, 0);
    o = run("estimate %s -o %s/", photo, out);
    assert_int_equal(o->status, 0);
    assert_contains(o->err, "one/overlay.png");
    /* The front shows the face that the back does not. */
    o = run("avatar %s -o %s", back, avatar);
    assert_int_equal(o->status, 0);
    assert_contains(o->err, "seen from behind");
    o = run("avatar %s %s -o %s", photo, back, avatar);
    assert_int_equal(o->status, 0);
    assert_contains(o->err, "photo-back.jpg: one person");
    assert_null(strstr(o->err, "seen from behind"));
    text_write(text, "<!DOCTYPE html><html></html>");
    snprintf(folder, sizeof folder, "%s", test_path("many"));
    o = run("estimate %s %s -o %s", text, photo, folder);
    assert_int_equal(o->status, 1);
    assert_contains(o->err, "text.jpg: ");
    assert_contains(o->err, "1 of 2 photos failed");
    snprintf(out, sizeof out, "%s/photo/observation.json", folder);
    assert_true(file_size(out) > 1000);
    assert_error(run("render %s --orbit 1 -o %s -q", text, test_path("x.png")), 1, "text.jpg", "web page");
    assert_error(run("estimate %s %s -o x --mask y", photo, text), 2, "--mask", "one photo");
    assert_error(run("estimate %s %s -o x", photo, photo), 1, "x/photo", "rename");
    assert_error(run("avatar %s -o x --person 3 -q", photo), 1, "person 3", "1 was found");
    assert_error(run("avatar %s -o x --person 9", photo), 2, "--person", "sherf avatar --help");
    assert_error(run("estimate /no/such/photo.jpg -o x -q"), 1, "sherf: ", "/no/such/photo.jpg");
    assert_error(run("avatar /dev/null -o x -q"), 1, "/dev/null", "neither a file nor a folder");
    assert_error(run("estimate %s -o x.npz", photo), 2, "is a photo", "-o FOLDER");
    assert_error(run("estimate %s -o x.npz -q", test_path(".")), 1, "sherf: ", "a folder, not a video");
    unsetenv("SHERF_ASSETS");
}

int main(void) {
    const char *program = getenv("SHERF_PROGRAM");
    if (!program || !*program) {
        puts("the program was not built");
        return 77;
    }
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(version_and_help),
        cmocka_unit_test(texts_agree),
        cmocka_unit_test(wrong_usage),
        cmocka_unit_test(outputs_are_checked),
        cmocka_unit_test(assets_beside_the_program),
        cmocka_unit_test(what_is_missing_or_broken),
        cmocka_unit_test(bench_answers),
        cmocka_unit_test(from_data_to_frames),
        cmocka_unit_test(animations),
        cmocka_unit_test(photos),
        cmocka_unit_test(interrupt_saves),
        cmocka_unit_test(last_weights_are_others),
    };
    if (getenv("SHERF_TEST_ONLY")) cmocka_set_test_filter(getenv("SHERF_TEST_ONLY"));
    return cmocka_run_group_tests(tests, NULL, NULL);
}
