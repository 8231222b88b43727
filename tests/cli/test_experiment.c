/* Tests of `sherf experiment`: killed in the middle of a training or stopped by a full disk, it continues. */
#include "program.h"

#include <ftw.h>

static char tubes[512], output[512];

static int make_data(void **state) {
    snprintf(tubes, sizeof tubes, "%s", test_path("tubes"));
    snprintf(output, sizeof output, "%s", test_path("out"));
    return run("synth tube -o %s --people 2 --poses 2 --views 24 --size 32 -q", tubes)->status;
}

static const char *words(void) {
    static char line[2000];
    snprintf(line, sizeof line,
             "experiment input-angle -p smoke -d thuman:%s --train-people 0 --test-people 1 -s 32 -n 30 "
             "--perceptual none -o %s",
             tubes, output);
    return line;
}

static bool is_there(const char *name) {
    char path[1200];
    snprintf(path, sizeof path, "%s/%s", output, name);
    return access(path, F_OK) == 0;
}

static time_t written(const char *name) {
    char path[1200];
    struct stat info;
    snprintf(path, sizeof path, "%s/%s", output, name);
    assert_int_equal(stat(path, &info), 0);
    return info.st_mtim.tv_sec * 1000 + info.st_mtim.tv_nsec / 1000000;
}

/* Kills the program when the second method has begun and the first is complete. The same command then does
 * the rest. */
static void a_kill_is_gone_on_from(void **state) {
    char out[4096], err[4096];
    snprintf(out, sizeof out, "%s", test_path("stdout"));
    snprintf(err, sizeof err, "%s", test_path("stderr"));
    int status;
    const pid_t child = start(words(), out, err);
    for (int i = 0; i < 6000 && !is_there("runs/thuman/mps-nerf-1/log.jsonl"); i++) usleep(10000);
    assert_int_equal(kill(child, SIGKILL), 0);
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFSIGNALED(status)); /* it had not finished */
    assert_true(is_there("runs/thuman/nhp-1/finished.json") &&
                is_there("runs/thuman/nhp-1/scores/angles-0/scores.json"));
    assert_false(is_there("runs/thuman/mps-nerf-1/finished.json"));
    const time_t before = written("runs/thuman/nhp-1/model.safetensors");
    const outcome *o = run("%s", words());
    assert_int_equal(o->status, 0);
    assert_contains(o->out, "| SHERF |");
    assert_true(written("runs/thuman/nhp-1/model.safetensors") == before);
    assert_true(is_there("input-angle/index.html") && is_there("input-angle/input-angle.svg") &&
                is_there("index.html"));
}

static void assert_there(const char *name, bool there) {
    if (is_there(name) != there) fail_msg("%s is %sthere", name, there ? "not " : "");
}

static int is_whole(const char *path, const struct stat *info, int type, struct FTW *at) {
    const size_t n = strlen(path);
    if (n > 5 && !strcmp(path + n - 5, ".part")) fail_msg("%s is left behind", path);
    return 0;
}

/* A full disk in the middle of a training, while writing a score page and in a study: one line, no
 * half-written file, and complete files stay. */
static void a_full_disk_loses_nothing(void **state) {
    char full[512];
    snprintf(full, sizeof full, "%s", test_path("full"));
    file_bytes_max = 60000; /* pictures and logs are smaller, checkpoints larger */
    assert_error(
        run("experiment main -q -p smoke -d thuman:%s --train-people 0 --test-people 1 -s 32 -n 2 --seeds 1 "
            "--perceptual none -o %s",
            tubes, full),
        1, "checkpoint.safetensors: cannot be written", "");
    assert_int_equal(nftw(full, is_whole, 16, FTW_PHYS), 0);
    file_bytes_max = 1100; /* the first test's results exist; only the new page is too large */
    assert_error(run("experiment angle-difference -q -p smoke -d thuman:%s --train-people 0 --test-people 1 "
                     "-s 32 -n 30 "
                     "--perceptual none -o %s",
                     tubes, output),
                 1, "cannot be written", "angle-difference");
    file_bytes_max = 0;
    assert_int_equal(nftw(output, is_whole, 16, FTW_PHYS), 0);
    assert_there("angle-difference/index.html", false);
    assert_there("input-angle/index.html", true);
    assert_there("runs/thuman/sherf-1/model.safetensors", true);
    assert_int_equal(
        run("experiment angle-difference -q -p smoke -d thuman:%s --train-people 0 --test-people 1 -s 32 "
            "-n 30 --perceptual none -o %s",
            tubes, output)
            ->status,
        0);
    assert_there("angle-difference/index.html", true);
    snprintf(output, sizeof output, "%s", full);
    assert_there("runs/thuman/pixelnerf-1/checkpoint.safetensors", false);
    assert_there("runs/thuman/pixelnerf-1/finished.json", false);
    assert_there("main", false);
}

static void words_that_are_wrong(void **state) {
    assert_error(run("experiment dance -o x"), 2, "'dance' is none of main|ablation",
                 "sherf experiment --help");
    assert_error(run("experiment main"), 2, "--output FOLDER is missing", "sherf experiment --help");
    assert_error(run("experiment main --score -o %s x.json", output), 2,
                 "--score is of the experiment preference", "sherf experiment --help");
    assert_error(run("experiment preference --score -o %s", output), 2, "files of answers are missing",
                 "sherf experiment --help");
    assert_error(run("experiment preference -o %s x.json", output), 2, "'x.json' is one argument too many",
                 "sherf experiment --help");
    assert_error(run("experiment preference --score -q -o %s x.json", output), 1, "preference/key.json", "");
    assert_error(run("experiment pifu -q -p smoke -d thuman:%s --train-people 0 --test-people 1 -s 32 -n 30 "
                     "--perceptual none -o %s",
                     tubes, output),
                 1, "experiment pifu needs people's surfaces", "surface/0.safetensors: not there");
    assert_error(run("experiment main -q -n 31 -p smoke -d thuman:%s -o %s", tubes, output), 1,
                 "made with other settings", "experiment.json");
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_kill_is_gone_on_from),
                                       cmocka_unit_test(words_that_are_wrong),
                                       cmocka_unit_test(a_full_disk_loses_nothing)};
    return cmocka_run_group_tests(tests, make_data, NULL);
}
