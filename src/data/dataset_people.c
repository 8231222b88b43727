/* Opening a data set: its kind, its people, and the paper's splits of them. */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/dataset.h"

#define DATASET_ENTRY(name) &dataset_##name,
static const dataset_reader *const readers[] = {DATA_SETS(DATASET_ENTRY)};

void sherf_dataset_free(sherf_dataset *d) {
    if (!d) return;
    for (int i = 0; i < d->people; i++) {
        if (d->cache && d->cache->record) record_free(d->cache->record[i]);
        mem_free(d->name[i]);
    }
    if (d->cache) {
        pthread_mutex_destroy(&d->cache->lock);
        mem_free(d->cache->record);
    }
    mem_free(d->cache);
    mem_free(d->name);
    mem_free(d->root);
    mem_free(d);
}

static sherf_status add_person(context *c, sherf_dataset *d, const char *name, size_t length) {
    if (d->people >= DATASET_PEOPLE_MAX)
        return failure(c, SHERF_BAD_FILE, "more than %d people", DATASET_PEOPLE_MAX);
    if ((d->people & (d->people - 1)) == 0) { /* full at every power of two */
        char **more =
            mem_grow(c, d->name, (size_t)d->people, d->people ? 2 * (size_t)d->people : 1, sizeof *more);
        if (!more) return SHERF_NO_MEMORY;
        d->name = more;
    }
    d->name[d->people] = mem_format(c, "%.*s", (int)length, name);
    if (!d->name[d->people]) return SHERF_NO_MEMORY;
    d->people++;
    return SHERF_OK;
}

/* A line is a name, or a path whose last part is the folder here. */
static sherf_status add_line(context *c, sherf_dataset *d, const char *line, size_t length) {
    char folder[PATH_LENGTH];
    while (length && (line[length - 1] == '\r' || line[length - 1] == ' ' || line[length - 1] == '/'))
        length--;
    if (!length || length > 1024) return SHERF_OK;
    for (size_t i = length; i-- > 0;)
        if (line[i] == '/' || line[i] == '\\') {
            int n = snprintf(folder, sizeof folder, "%s/%.*s", d->root, (int)length, line);
            if (line[0] == '/' || n < 0 || n >= (int)sizeof folder || !path_is_folder(folder)) {
                line += i + 1;
                length -= i + 1;
            }
            break;
        }
    return length ? add_person(c, d, line, length) : SHERF_OK;
}

/* One person per line. *found: the file exists. */
static sherf_status read_list(context *c, sherf_dataset *d, const char *file, bool *found) {
    char path[PATH_LENGTH];
    unsigned char *data = NULL;
    size_t bytes;
    sherf_status status = path_join(c, path, sizeof path, d->root, file);
    if (status) return status;
    *found = path_is_file(path);
    if (!*found) return SHERF_OK;
    if ((status = file_read(c, path, (size_t)16 << 20, &data, &bytes))) return status;
    for (size_t at = 0; at < bytes && !status;) {
        const unsigned char *end = memchr(data + at, '\n', bytes - at);
        size_t length = end ? (size_t)(end - (data + at)) : bytes - at;
        size_t text = 0;
        while (text < length && data[at + text]) text++;
        status = add_line(c, d, (const char *)data + at, text);
        at += length + 1;
    }
    mem_free(data);
    return status ? failure_prefix(c, status, "%s", path) : SHERF_OK;
}

/* The layout of one person's folder; NULL: none. */
static const dataset_reader *person_layout(const char *folder) {
    for (size_t i = 0; i < COUNT_OF(readers); i++)
        if (readers[i]->recognise(folder)) return readers[i];
    return NULL;
}

static int by_name(const void *a, const void *b) {
    return strcmp(*(char *const *)a, *(char *const *)b);
}

/* Folders that have a person's layout, sorted by name. */
static sherf_status list_folders(context *c, sherf_dataset *d) {
    char path[PATH_LENGTH];
    sherf_status status = SHERF_OK;
    DIR *dir = opendir(d->root);
    if (!dir) return failure(c, SHERF_NO_FILE, "%s: cannot be opened", d->root);
    for (struct dirent *e; !status && (e = readdir(dir));) {
        if (e->d_name[0] == '.') continue;
        status = path_join(c, path, sizeof path, d->root, e->d_name);
        if (!status && person_layout(path)) status = add_person(c, d, e->d_name, strlen(e->d_name));
    }
    closedir(dir);
    if (!status && d->people) qsort(d->name, (size_t)d->people, sizeof *d->name, by_name);
    return status;
}

static sherf_status find_people(context *c, sherf_dataset *d) {
    bool found = false;
    sherf_status status = read_list(c, d, "train.txt", &found);
    if (status) return status;
    d->train_listed = d->people;
    if ((status = read_list(c, d, "test.txt", &found))) return status;
    d->test_listed = d->people - d->train_listed;
    if (d->people) return SHERF_OK;
    if ((status = read_list(c, d, "human_list.txt", &found))) return status;
    d->listed = d->people > 0;
    return d->people ? SHERF_OK : list_folders(c, d);
}

const dataset_reader *dataset_reader_named(const char *spec, const char **path) {
    for (size_t i = 0; i < COUNT_OF(readers); i++) {
        const char *name = readers[i]->protocol.name;
        size_t n = strlen(name);
        *path = spec + n + 1;
        if (!strncmp(spec, name, n) && spec[n] == ':') return readers[i];
    }
    *path = spec;
    return NULL;
}

static sherf_status recognise(context *c, sherf_dataset *d) {
    char folder[PATH_LENGTH], known[200];
    for (int i = 0; i < d->people && i < 16; i++) {
        sherf_status status = dataset_path(c, d, i, "", folder);
        if (status) return status;
        d->reader = person_layout(folder);
        if (d->reader) return SHERF_OK;
    }
    size_t n = 0;
    for (size_t i = 0; i < COUNT_OF(readers) && n < sizeof known; i++)
        n += (size_t)snprintf(known + n, sizeof known - n, "%s%s", i ? ", " : "", readers[i]->protocol.name);
    return failure(c, SHERF_BAD_FILE, "%s: the layout is none of %s; name it as in thuman:PATH", d->root,
                   known);
}

sherf_status sherf_dataset_open(sherf_context *c, const char *spec, sherf_dataset **out) {
    *out = NULL;
    const char *path;
    const dataset_reader *reader = dataset_reader_named(spec, &path);
    size_t length = strlen(path);
    while (length > 1 && path[length - 1] == '/') length--;
    sherf_status status = SHERF_NO_MEMORY;
    sherf_dataset *d = mem_zero(c, 1, sizeof *d);
    if (!d) return status;
    d->reader = reader;
    d->root = mem_format(c, "%.*s", (int)length, path);
    if (!d->root) goto fail;
    if (!path_is_folder(d->root)) {
        status = failure(c, SHERF_NO_FILE, "%s: no such folder", d->root);
        goto fail;
    }
    if ((status = find_people(c, d))) goto fail;
    if (!d->people) {
        status = failure(c, SHERF_BAD_FILE,
                         person_layout(d->root)
                             ? "%s: one person's folder; give the folder that holds the people"
                             : "%s: no people in it (neither human_list.txt nor folders of a known layout)",
                         d->root);
        goto fail;
    }
    if (!d->reader && (status = recognise(c, d))) goto fail;
    status = SHERF_NO_MEMORY;
    d->cache = mem_zero(c, 1, sizeof *d->cache);
    if (!d->cache) goto fail;
    pthread_mutex_init(&d->cache->lock, NULL);
    d->cache->record = mem_zero(c, (size_t)d->people, sizeof *d->cache->record);
    if (!d->cache->record) goto fail;
    *out = d;
    return SHERF_OK;
fail:
    sherf_dataset_free(d);
    return status;
}

/* ---- choosing people ---- */

static void take_range(const sherf_dataset *d, int first, int n, int *index, int *count) {
    for (int i = first; i < first + n && i < d->people; i++) index[(*count)++] = i;
}

/* Whether train.txt or test.txt says who the people are, in place of human_list.txt and the folders. */
static bool split_is_own(const sherf_dataset *d) {
    return d->train_listed + d->test_listed > 0;
}

static sherf_status paper_split(context *c, const sherf_dataset *d, bool training, int *index, int *count) {
    const data_protocol *p = dataset_protocol(d);
    int wanted = training ? p->train_count : p->test_count, first = training ? p->train_first : p->test_first;
    if (split_is_own(d)) {
        take_range(d, training ? 0 : d->train_listed, training ? d->train_listed : d->test_listed, index,
                   count);
        wanted = *count;
    } else if (d->reader->split) {
        d->reader->split(c, d, training, index, count);
        wanted = *count;
    } else {
        take_range(d, first, wanted, index, count);
    }
    if (!*count && split_is_own(d))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "%s: %s.txt gives the people, and there is no %s.txt; choose people by name or line",
                       d->root, training ? "test" : "train", training ? "train" : "test");
    if (!*count)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "%s: nobody of the paper's %s split is among its %d people; choose people by name "
                       "or line",
                       d->root, training ? "training" : "test", d->people);
    if (*count < wanted)
        log_line(c, SHERF_LOG_WARNING, "%s: %d of the %d people of the paper's %s split", d->root, *count,
                 wanted, training ? "training" : "test");
    return SHERF_OK;
}

/* "name", "3" or "90-99" (lines from 0). */
static sherf_status take_item(context *c, const sherf_dataset *d, const char *item, size_t length, int *index,
                              int *count, int room) {
    int person = dataset_find(d, item, length), first = 0, last = 0, end = 0;
    if (person < 0) {
        char text[64] = "";
        if (length < sizeof text) memcpy(text, item, length);
        text[length < sizeof text ? length : 0] = 0;
        if (sscanf(text, "%9d-%9d%n", &first, &last, &end) == 2 && !text[end])
            ;
        else if (sscanf(text, "%9d%n", &first, &end) == 1 && !text[end])
            last = first;
        else
            return failure(c, SHERF_BAD_ARGUMENT,
                           "%s: no person \"%.*s\"%s; people are names, or lines such as 0-%d", d->root,
                           (int)length, item, split_is_own(d) ? " in train.txt or test.txt" : "",
                           d->people - 1);
        if (first < 0 || last < first || last >= d->people)
            return failure(c, SHERF_BAD_ARGUMENT, "%s: no people %.*s (lines 0 to %d%s are there)", d->root,
                           (int)length, item, d->people - 1,
                           split_is_own(d) ? " of train.txt and test.txt together" : "");
    } else {
        first = last = person;
    }
    for (int i = first; i <= last; i++) {
        bool taken = false;
        for (int k = 0; k < *count; k++) taken |= index[k] == i;
        if (!taken && *count < room) index[(*count)++] = i;
    }
    return SHERF_OK;
}

sherf_status dataset_people(context *c, const sherf_dataset *d, const char *names, bool training,
                            int **indices, int *count) {
    *indices = NULL;
    *count = 0;
    sherf_status status = SHERF_OK;
    int n = 0, *index = mem_alloc(c, (size_t)d->people + 16, sizeof *index);
    if (!index) return SHERF_NO_MEMORY;
    if (!names) status = paper_split(c, d, training, index, &n);
    while (names && *names && !status) {
        size_t length = strcspn(names, ",");
        if (length) status = take_item(c, d, names, length, index, &n, d->people);
        names += length + (names[length] == ',');
    }
    if (!status && !n) status = failure(c, SHERF_BAD_ARGUMENT, "%s: no people are chosen", d->root);
    if (status) {
        mem_free(index);
        return status;
    }
    *indices = index;
    *count = n;
    return SHERF_OK;
}
