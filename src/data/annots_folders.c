/* Finds data that annots.npy does not list (a refined ZJU-MoCap has only cameras): pictures by view
 * and pose, from the existing folders; and files under unusual names. */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/annots.h"

enum { NAME = 96 };
typedef struct {
    char text[NAME];
    int64_t number; /* the last one in the name; -1: there is none */
} numbered;
typedef struct {
    numbered *item;
    int count, room;
} name_list;

static int64_t last_number(const char *name) {
    const char *point = strrchr(name, '.');
    size_t end = point ? (size_t)(point - name) : strlen(name);
    while (end && (name[end - 1] < '0' || name[end - 1] > '9')) end--;
    size_t begin = end;
    while (begin && name[begin - 1] >= '0' && name[begin - 1] <= '9' && end - begin < 9) begin--;
    return end > begin ? strtoll(name + begin, NULL, 10) : -1;
}

static int by_number(const void *a, const void *b) {
    const numbered *x = a, *y = b;
    if (x->number != y->number) return x->number < y->number ? -1 : 1;
    return strcmp(x->text, y->text);
}

static bool is_picture(const char *name) {
    static const char *const endings[] = {".png", ".jpg", ".jpeg", ".webp"};
    for (size_t i = 0; i < COUNT_OF(endings); i++)
        if (path_ends(name, endings[i])) return true;
    return false;
}

/* Lists folders, or pictures, with numbers in their names, sorted by number. A folder that cannot be opened
 * counts as empty. */
static sherf_status list(context *c, const char *path, bool folders, name_list *out) {
    char own[PATH_LENGTH];
    DIR *d = opendir(path);
    sherf_status status = SHERF_OK;
    *out = (name_list){0};
    for (struct dirent *e; d && !status && (e = readdir(d));) {
        numbered n = {.number = last_number(e->d_name)};
        if (n.number < 0 || *e->d_name == '.' || strlen(e->d_name) >= NAME) continue;
        memcpy(n.text, e->d_name, strlen(e->d_name) + 1);
        if ((status = path_join(c, own, sizeof own, path, n.text))) break;
        if (folders ? !path_is_folder(own) : !is_picture(n.text)) continue;
        if (out->count == out->room) {
            const int room = out->room ? 2 * out->room : 64;
            numbered *grown = mem_grow(c, out->item, (size_t)out->room, (size_t)room, sizeof *grown);
            if (!grown) status = SHERF_NO_MEMORY;
            if (grown) out->item = grown, out->room = room;
        }
        if (!status) out->item[out->count++] = n;
    }
    if (d) closedir(d);
    if (out->count) qsort(out->item, (size_t)out->count, sizeof *out->item, by_number);
    return status;
}

/* The folder of views: the person's own, or one of pictures inside it. `inside` is empty or "images/". */
static sherf_status views_find(context *c, const char *folder, const char **inside, name_list *out) {
    static const char *const places[] = {"", "images/", "image/", "imgs/"};
    char path[PATH_LENGTH];
    sherf_status status = SHERF_OK;
    for (size_t i = 0; i < COUNT_OF(places) && !status; i++) {
        *inside = places[i];
        status = path_join(c, path, sizeof path, folder, places[i]);
        if (!status) status = list(c, path, true, out);
        if (!status && out->count) return SHERF_OK;
        mem_free(out->item);
        *out = (name_list){0};
    }
    return status ? status
                  : failure(c, SHERF_BAD_FILE,
                            "no ims, and no folders with numbers of views (view00, Camera_B1)");
}

/* If there are as many folders as cameras, they are the views in order; otherwise their numbers identify
 * them. */
static sherf_status views_match(context *c, int views, const name_list *found, int *view_of) {
    for (int i = 0; i < found->count; i++) {
        view_of[i] = found->count == views           ? i
                     : found->item[i].number < views ? (int)found->item[i].number
                                                     : -1;
        if (view_of[i] < 0 || found->count > views)
            return failure(c, SHERF_BAD_FILE, "no ims, and %d folders of pictures (%s, ...) for %d cameras",
                           found->count, found->item[0].text, views);
    }
    return SHERF_OK;
}

/* Lists the pictures of a view, whose folder is `relative` below `folder`. */
static sherf_status list_view(context *c, const char *folder, const char *inside, const char *name,
                              char relative[PATH_LENGTH], name_list *pictures) {
    char path[PATH_LENGTH];
    snprintf(relative, PATH_LENGTH, "%s%s", inside, name);
    sherf_status status = path_join(c, path, sizeof path, folder, relative);
    return status ? status : list(c, path, false, pictures);
}

static sherf_status take_view(context *c, const char *folder, const char *inside, const char *name, int view,
                              person_record *r) {
    char relative[PATH_LENGTH];
    name_list pictures = {0};
    sherf_status status = list_view(c, folder, inside, name, relative, &pictures);
    if (status) return status;
    for (int p = 0, i = 0; p < r->poses && i < pictures.count && !status; i++) {
        while (p < r->poses && r->number[p] < pictures.item[i].number) p++;
        if (p == r->poses || r->number[p] != pictures.item[i].number) continue;
        char **image = &r->image[(int64_t)p * r->views + view];
        if (!*image && !(*image = mem_format(c, "%s/%s", relative, pictures.item[i].text)))
            status = SHERF_NO_MEMORY;
    }
    mem_free(pictures.item);
    return status;
}

/* The first view's pictures define the poses. */
static sherf_status take_poses(context *c, const char *folder, const char *inside, const char *first,
                               person_record *r) {
    char relative[PATH_LENGTH];
    name_list pictures = {0};
    sherf_status status = list_view(c, folder, inside, first, relative, &pictures);
    if (!status && (!pictures.count || pictures.count > DATASET_POSES_MAX))
        status = failure(c, SHERF_BAD_FILE, "no ims, and no numbered pictures in %s", relative);
    const size_t poses = status ? 0 : (size_t)pictures.count;
    if (!status) r->number = mem_zero(c, poses, sizeof *r->number);
    if (!status) r->image = mem_zero(c, poses * (size_t)r->views, sizeof *r->image);
    if (!status && (!r->number || !r->image)) status = SHERF_NO_MEMORY;
    if (!status) r->poses = (int)poses;
    for (size_t p = 0; p < poses && !status; p++) r->number[p] = (int)pictures.item[p].number;
    mem_free(pictures.item);
    return status;
}

sherf_status annots_from_folders(context *c, const char *folder, person_record *r) {
    const char *inside;
    name_list found = {0};
    int *view_of = NULL;
    sherf_status status = views_find(c, folder, &inside, &found);
    if (!status && !(view_of = mem_alloc(c, (size_t)found.count, sizeof *view_of))) status = SHERF_NO_MEMORY;
    if (!status) status = views_match(c, r->views, &found, view_of);
    if (!status) status = take_poses(c, folder, inside, found.item[0].text, r);
    for (int i = 0; i < found.count && !status; i++)
        status = take_view(c, folder, inside, found.item[i].text, view_of[i], r);
    mem_free(view_of);
    mem_free(found.item);
    return status;
}

/* FOLDER/PLACE/STEM with any picture ending; false: it is in none of the places (NULL ends them). */
static bool find_picture(const char *folder, const char *const *places, const char *stem, int length,
                         char out[PATH_LENGTH]) {
    static const char *const endings[] = {".png", ".jpg", ".jpeg", ".webp", ".PNG", ".JPG"};
    char path[PATH_LENGTH];
    for (; *places; places++)
        for (size_t i = 0; i < COUNT_OF(endings); i++) {
            const int n =
                snprintf(path, sizeof path, "%s/%s%.*s%s", folder, *places, length, stem, endings[i]);
            if (n < 0 || n >= PATH_LENGTH || !path_is_file(path)) continue;
            memcpy(out, path, sizeof path);
            return true;
        }
    return false;
}

static int stem_length(const char *image) {
    const char *name = strrchr(image, '/'), *point = strrchr(image, '.');
    return point && (!name || point > name) ? (int)(point - image) : (int)strlen(image);
}

sherf_status annots_image(context *c, const char *folder, const char *image, char out[PATH_LENGTH]) {
    static const char *const places[] = {"", "images/", "image/", "imgs/", NULL};
    sherf_status status = path_join(c, out, PATH_LENGTH, folder, image);
    if (!status && !path_is_file(out)) find_picture(folder, places, image, stem_length(image), out);
    return status;
}

sherf_status annots_mask(context *c, const char *folder, const char *image, char out[PATH_LENGTH]) {
    static const char *const places[] = {"mask_cihp/", "mask/", "masks/", NULL};
    static const char *const prefixes[] = {"images/", "image/", "imgs/"};
    const int n = snprintf(out, PATH_LENGTH, "%s/mask_cihp/%.*s.png", folder, stem_length(image), image);
    if (n < 0 || n >= PATH_LENGTH)
        return failure(c, SHERF_BAD_FILE, "%.200s/%.200s: path too long", folder, image);
    for (size_t i = 0; i < COUNT_OF(prefixes); i++)
        if (!strncmp(image, prefixes[i], strlen(prefixes[i]))) image += strlen(prefixes[i]);
    find_picture(folder, places, image, stem_length(image), out);
    return SHERF_OK;
}
