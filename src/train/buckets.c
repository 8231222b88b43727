/* Sums of gradients over processes, a stretch of the block at a time. */
#include "train/buckets.h"

/* Stretches should be long enough that starting a sum costs little, and short enough that nobody waits long
 * for the last one. */
enum { BUCKET_FLOATS = 4 << 20 };

typedef struct {
    int64_t begin, end; /* of the block */
    int first, last;    /* of the parameters, in the block's order; without the last */
    int waiting;        /* parameters that are not final */
} bucket;

struct buckets {
    context *c;
    const parameters *weights;
    const ranks *ranks;
    buckets_ready_function ready;
    void *user;
    int count, next; /* buckets[0 .. next - 1] are on their way; 0 is the block's end */
    bucket *bucket;
    int parameters;
    parameter **item; /* the trained ones, as they lie in the block */
    bool *final;
    sherf_status status;
};

void buckets_free(buckets *b) {
    if (!b) return;
    mem_free(b->bucket);
    mem_free(b->item);
    mem_free(b->final);
    mem_free(b);
}

/* Cuts the block from its end. */
static void cut(buckets *b) {
    int last = b->parameters;
    int64_t end = b->weights->trained_floats;
    while (last > 0) {
        int first = last - 1;
        while (first > 0 && end - b->item[first - 1]->offset <= BUCKET_FLOATS) first--;
        b->bucket[b->count++] = (bucket){b->item[first]->offset, end, first, last, 0};
        end = b->item[first]->offset;
        last = first;
    }
}

sherf_status buckets_create(context *c, const parameters *weights, const ranks *r,
                            buckets_ready_function ready, void *user, buckets **out) {
    *out = NULL;
    buckets *b = mem_zero(c, 1, sizeof *b);
    if (!b) return SHERF_NO_MEMORY;
    *b = (buckets){.c = c, .weights = weights, .ranks = r, .ready = ready, .user = user};
    const size_t max = (size_t)weights->count;
    b->bucket = mem_zero(c, max, sizeof *b->bucket);
    b->item = mem_zero(c, max, sizeof *b->item);
    b->final = mem_zero(c, max, sizeof *b->final);
    if (!b->bucket || !b->item || !b->final) {
        buckets_free(b);
        return SHERF_NO_MEMORY;
    }
    for (int i = 0; i < weights->count; i++) /* parameters are laid out in their order */
        if (!weights->item[i]->buffer) b->item[b->parameters++] = weights->item[i];
    cut(b);
    *out = b;
    return SHERF_OK;
}

void buckets_begin(buckets *b) {
    for (int i = 0; i < b->parameters; i++) {
        b->final[i] = false;
        b->item[i]->value.first_use = NULL;
    }
    for (int k = 0; k < b->count; k++) b->bucket[k].waiting = b->bucket[k].last - b->bucket[k].first;
    b->next = 0;
    b->status = SHERF_OK;
}

static void send(context *c, buckets *b) {
    const bucket *k = &b->bucket[b->next++];
    const tensor_memory *memory = b->weights->memory;
    const int64_t n = k->end - k->begin;
    if (b->status == SHERF_OK) b->status = b->ready(c, b->user, k->begin, n);
    if (b->status == SHERF_OK)
        b->status = memory->groups->sum(c, b->ranks->group, n, b->weights->grads + k->begin);
}

/* The parameter with this value; -1: it is not one of these. */
static int place_of(const buckets *b, const tensor *value) {
    const int64_t offset = tensor_f32(value) - b->weights->values;
    int low = 0, high = b->parameters - 1;
    while (low < high) {
        const int middle = (low + high + 1) / 2;
        if (b->item[middle]->offset <= offset)
            low = middle;
        else
            high = middle - 1;
    }
    return high >= 0 && &b->item[low]->value == value ? low : -1;
}

static void mark(buckets *b, int i) {
    if (i < 0 || b->final[i]) return;
    b->final[i] = true;
    for (int k = 0; k < b->count; k++)
        if (i >= b->bucket[k].first && i < b->bucket[k].last) b->bucket[k].waiting--;
}

void buckets_final(void *user, tensor *value) {
    buckets *b = user;
    if (value) mark(b, place_of(b, value));
    for (int i = 0; i < b->parameters && !value; i++)
        if (!b->item[i]->value.first_use) mark(b, i);
    while (b->next < b->count && !b->bucket[b->next].waiting) send(b->c, b);
}

sherf_status buckets_finish(context *c, buckets *b) {
    const tensor_memory *memory = b->weights->memory;
    while (b->next < b->count) send(c, b);
    return b->status == SHERF_OK ? memory->groups->wait(c, b->ranks->group) : b->status;
}
