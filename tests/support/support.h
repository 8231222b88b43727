/* Shared by all test programs: contexts, temporary paths, processor levels, assertions. */
#ifndef TEST_SUPPORT_H
#define TEST_SUPPORT_H
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <setjmp.h>
#include <cmocka.h>

#include "base/base.h"

context *test_context(void); /* float32, 2 threads; aborts if it cannot be made */
/* For groups of tests that share one context as their *state. Closing it fails if anything leaked. */
int test_open(void **state);
int test_close(void **state);
/* centred(NAME, shape, s) of the reference rules: float32(s * (2u - 1)), n values. */
void test_centred(const char *name, int64_t n, double scale, float *out);
/* A path in a fresh temporary folder of this test program, removed at exit; static storage, 4 at a time. */
const char *test_path(const char *name);
/* Levels of the processor, for tests that compare them. The highest is the one that SHERF_ISA allowed at the
 * start; a test never removes an existing mask. */
isa_level test_isa_highest(void);
bool test_isa(isa_level level); /* masks the processor to it; false: it is above the highest or of another
                                   processor, and nothing changes */
void test_isa_restore(void);    /* restores the level at the program's start */
/* For tests of bf16 products on the processor: skips the test, with a message, if it has none. */
#define skip_without_bf16()                                                                                  \
    do {                                                                                                     \
        if (isa_has_bf16()) break;                                                                           \
        print_message("skipped: bf16 needs AMX, this is %s\n", isa_name(isa_best()));                        \
        skip();                                                                                              \
    } while (0)
/* Fails the test with the context's message unless status is SHERF_OK. */
#define assert_ok(c, call)                                                                                   \
    do {                                                                                                     \
        sherf_status status_ = (call);                                                                       \
        if (status_ != SHERF_OK) fail_msg("%s: status %d: %s", #call, (int)status_, (c)->message);           \
    } while (0)
/* Fails the test unless the call gives that status and a message that contains `text`. */
#define assert_fails(c, call, wanted, text)                                                                  \
    do {                                                                                                     \
        sherf_status status_ = (call);                                                                       \
        if (status_ != (wanted) || !strstr((c)->message, text))                                              \
            fail_msg("%s: status %d: \"%s\" (expected %d, \"%s\")", #call, (int)status_, (c)->message,       \
                     (int)(wanted), text);                                                                   \
    } while (0)
/* PSNR in dB of a picture against another of the same size; 200 if they are equal. */
double test_psnr(const sherf_image *a, const sherf_image *b);
#endif
