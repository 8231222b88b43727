/* Tests of src/base: hashes, arenas, failures, threads, outputs. */
#include "support.h"

#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/path.h"

static void hash_generator(void **state) {
    /* splitmix64(0) is the published first output of the seed 0 generator. */
    assert_true(splitmix64(0) == 0xE220A8397B1DCDAFu);
    assert_true(fnv1a64("") == 0xCBF29CE484222325u);
    assert_true(fnv1a64("a") == 0xAF63DC4C8601EC8Cu);
    for (uint64_t i = 0; i < 1000; i++) {
        double u = random_uniform(7, i);
        assert_true(u >= 0 && u < 1);
        assert_in_range(random_below(9, i, 5), 0, 4);
    }
}

static void arena_reuses_memory(void **state) {
    context *c = test_context();
    arena *a = arena_create(c);
    for (int round = 0; round < 3; round++) {
        long before = mem_count();
        for (int i = 0; i < 100; i++) {
            char *p = arena_alloc(c, a, 100000, 1);
            assert_non_null(p);
            assert_int_equal((uintptr_t)p % 64, 0);
            memset(p, i, 100000);
        }
        if (round == 2) assert_int_equal(mem_count(), before);
        arena_reset(a);
    }
    arena_mark mark = arena_position(a);
    char *p = arena_alloc(c, a, 10, 1);
    arena_rewind(a, mark);
    assert_ptr_equal(p, arena_alloc(c, a, 10, 1));
    arena_free(a);
    sherf_context_free(c);
}

static void failures_are_told(void **state) {
    context *c = test_context();
    mem_fail_after(0);
    assert_null(mem_alloc(c, 1, 1));
    assert_non_null(strstr(c->message, "out of memory"));
    assert_null(mem_alloc(c, SIZE_MAX / 2, 4));
    failure(c, SHERF_BAD_FILE, "two\nlines");
    assert_string_equal(sherf_message(c), "two lines");
    failure_prefix(c, SHERF_BAD_FILE, "file");
    assert_string_equal(sherf_message(c), "file: two lines");
    sherf_context_free(c);
}

static void add_range(void *arg, int64_t begin, int64_t end, int thread) {
    for (int64_t i = begin; i < end; i++) ((int *)arg)[i]++;
}

#if defined(__has_feature)
#define SANITIZED (__has_feature(address_sanitizer) || __has_feature(thread_sanitizer))
#elif defined(__SANITIZE_ADDRESS__)
#define SANITIZED 1
#else
#define SANITIZED 0
#endif

/* Bytes of address space that this process has. */
static size_t address_space(void) {
    unsigned long pages = 0;
    FILE *f = fopen("/proc/self/statm", "r");
    if (!f || fscanf(f, "%lu", &pages) != 1) pages = 0;
    if (f) fclose(f);
    return (size_t)pages * (size_t)sysconf(_SC_PAGESIZE);
}

/* Runs in a process with room for a few stacks of 8 MiB. Returns 0 for success, NO_LIMIT if limits have no
 * effect (qemu-user). */
enum { WANTED = 40, NO_LIMIT = 77 };
static int little_room(void) {
    int hits[WANTED] = {0};
    const rlim_t limit = address_space() + ((size_t)100 << 20);
    const struct rlimit room = {limit, limit};
    if (!mem_room((size_t)1 << 30) || setrlimit(RLIMIT_AS, &room)) return 1;
    if (mmap(NULL, (size_t)1 << 30, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) != MAP_FAILED)
        return NO_LIMIT;
    if (mem_room((size_t)1 << 30) || !mem_room((size_t)1 << 20)) return 2;
    const int threads = threads_make(WANTED);
    if (threads < 2 || threads >= WANTED) return 3;
    const context c = {.threads = threads};
    parallel_for(&c, WANTED, 1, add_range, hits);
    for (int i = 0; i < WANTED; i++)
        if (hits[i] != 1) return 4;
    return 0;
}

/* OpenMP would end the process. This test runs first, because a fork inherits none of the threads. */
static void threads_that_memory_allows(void **state) {
    if (SANITIZED) skip(); /* shadow memory exceeds any limit */
    int status;
    fflush(NULL);
    const pid_t child = fork();
    if (!child) _exit(little_room());
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFEXITED(status));
    if (WEXITSTATUS(status) == NO_LIMIT) skip();
    assert_int_equal(WEXITSTATUS(status), 0);
    assert_int_equal(threads_make(3), 3);
}

static void parallel_covers_once(void **state) {
    context *c = test_context();
    int hits[1000] = {0};
    parallel_for(c, 1000, 16, add_range, hits);
    for (int i = 0; i < 1000; i++) assert_int_equal(hits[i], 1);
    sherf_context_free(c);
}

/* An output is renamed into place, but never over a device or a folder. */
static void outputs_are_files(void **state) {
    context *c = test_context();
    const char *bad[] = {"/dev/null", "/dev", "/nonexistent/file"};
    for (size_t i = 0; i < COUNT_OF(bad); i++) {
        output_file out;
        assert_int_equal(output_open(c, bad[i], &out), SHERF_WRITE_FAILED);
        assert_non_null(strstr(c->message, bad[i]));
        output_abort(&out);
    }
    assert_int_equal(folder_make(c, ""), SHERF_BAD_ARGUMENT);
    output_file out;
    const char *path = test_path("whole");
    for (int twice = 0; twice < 2; twice++) { /* an old file is replaced */
        assert_ok(c, output_open(c, path, &out));
        assert_ok(c, output_write(c, &out, "text", 4));
        assert_ok(c, output_commit(c, &out));
        assert_true(path_is_file(path));
    }
    sherf_context_free(c);
}

/* A full disk is reported, whether it is noticed at a full buffer or at the end. The old file stays, and
 * nothing else does. */
static void a_full_disk_leaves_what_was(void **state) {
    static const char old[] = "old";
    static char much[100000];
    static const size_t bytes[] = {2000, sizeof much}; /* less than a buffer, and more */
    context *c = test_context();
    struct rlimit was;
    char part[600];
    const char *path = test_path("full");
    assert_ok(c, file_write(c, path, old, sizeof old));
    snprintf(part, sizeof part, "%s.%ld.part", path, (long)getpid());
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &was), 0);
    void (*const handler)(int) = signal(SIGXFSZ, SIG_IGN);
    for (size_t i = 0; i < COUNT_OF(bytes); i++) {
        assert_int_equal(setrlimit(RLIMIT_FSIZE, &(struct rlimit){1000, was.rlim_max}), 0);
        const sherf_status status = file_write(c, path, much, bytes[i]);
        assert_int_equal(setrlimit(RLIMIT_FSIZE, &was), 0);
        assert_int_equal(status, SHERF_WRITE_FAILED);
        assert_non_null(strstr(c->message, "full: cannot be written: "));
        assert_int_equal(access(part, F_OK), -1);
        unsigned char *data;
        size_t length;
        assert_ok(c, file_read(c, path, sizeof much, &data, &length));
        assert_int_equal(length, sizeof old);
        assert_memory_equal(data, old, sizeof old);
        mem_free(data);
    }
    signal(SIGXFSZ, handler);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_full_disk_leaves_what_was),
                                       cmocka_unit_test(threads_that_memory_allows),
                                       cmocka_unit_test(hash_generator),
                                       cmocka_unit_test(arena_reuses_memory),
                                       cmocka_unit_test(failures_are_told),
                                       cmocka_unit_test(parallel_covers_once),
                                       cmocka_unit_test(outputs_are_files)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
