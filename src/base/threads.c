/* parallel_for on OpenMP. Inside a parallel region it stays on the calling thread. */
#include <omp.h>
#include <pthread.h>
#include <stdlib.h>

#include "base/base.h"

int threads_available(void) {
    int n = omp_get_num_procs();
    return n > 0 ? n : 1;
}

static void *wait_for_the_others(void *lock) {
    pthread_mutex_lock(lock);
    pthread_mutex_unlock(lock);
    return NULL;
}

/* The number of threads, at most n, that can run at once. */
static int threads_possible(int n) {
    pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
    pthread_t *thread = calloc((size_t)n, sizeof *thread);
    int made = 0;
    pthread_mutex_lock(&lock);
    while (thread && made < n && pthread_create(&thread[made], NULL, wait_for_the_others, &lock) == 0) made++;
    pthread_mutex_unlock(&lock);
    for (int i = 0; i < made; i++) pthread_join(thread[i], NULL);
    free(thread);
    return made;
}

int threads_make(int n) {
    static _Thread_local int there = 1;
    if (n <= there || omp_in_parallel()) return n;
    const int possible = 1 + threads_possible(n - 1);
#pragma omp parallel num_threads(possible)
    {}
    there = possible;
    return possible;
}

void parallel_for(const context *c, int64_t n, int64_t grain, range_function f, void *arg) {
    if (n <= 0) return;
    if (grain < 1) grain = 1;
    int64_t parts = (n + grain - 1) / grain;
    if (parts > c->threads) parts = c->threads;
    if (parts <= 1 || omp_in_parallel()) {
        f(arg, 0, n, 0);
        return;
    }
#pragma omp parallel for schedule(static, 1) num_threads((int)parts)
    for (int64_t i = 0; i < parts; i++) f(arg, n * i / parts, n * (i + 1) / parts, (int)i);
}
