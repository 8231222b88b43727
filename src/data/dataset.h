/* The inside of a data set, and what a reader of a layout is. A data set is one file that defines a
 * dataset_reader, and its name in DATA_SETS. */
#ifndef SHERF_DATA_DATASET_H
#define SHERF_DATA_DATASET_H

#include <pthread.h>

#include "base/path.h"
#include "data/view.h"

enum { DATASET_PEOPLE_MAX = 100000, DATASET_VIEWS_MAX = 10000, DATASET_POSES_MAX = 1000000 };

/* The record of a person, made by the first request. It never changes afterwards. */
typedef struct {
    int poses, views;
    parsed_camera *camera; /* views; T in metres */
    int *number;           /* THuman, ZJU-MoCap: poses; the number in the parameter files' names */
    char **image;          /* THuman, ZJU-MoCap: poses x views, below the person's folder; NULL: missing */
    sherf_pose *pose;      /* RenderPeople: poses */
    bool *present;         /* HuMMan: poses; frames are numbered as their files, with gaps */
} person_record;

typedef struct {
    pthread_mutex_t lock;
    person_record **record; /* by person; NULL: not read yet */
} record_cache;

enum { DATASET_POSE_KEYS = 4 };

/* How the folders of a data set's people are laid out. `folder` is one person's, `r` his record; poses and
 * views lie inside the record. */
typedef struct {
    data_protocol protocol;
    /* Whether the folder has this layout. If several readers say so, the first of DATA_SETS takes it. */
    bool (*recognise)(const char *folder);
    sherf_status (*record)(context *c, const char *folder, person_record *r); /* fills *r, which is zeroed */
    sherf_status (*picture)(context *c, const person_record *r, const char *folder, int pose, int view,
                            char image[PATH_LENGTH], char mask[PATH_LENGTH]);
    /* The file that holds the pose, and (may not exist) that of its vertices in the world; "": none. */
    sherf_status (*pose_files)(context *c, const person_record *r, const char *folder, int pose,
                               char parameters[PATH_LENGTH], char vertices[PATH_LENGTH]);
    /* What a pose's file must have, by either name, and this in words. Not used where records hold the poses.
     */
    const char *pose_keys[DATASET_POSE_KEYS][2];
    const char *pose_needs;
    bool edge_band; /* a band along the mask's edge is uncertain (view_source) */
    /* The paper's people, as indices; NULL: lines of human_list.txt, by the protocol. */
    void (*split)(context *c, const sherf_dataset *d, bool training, int *index, int *count);
} dataset_reader;

#define DATA_SETS(X) X(thuman) X(zju_mocap) X(humman) X(renderpeople)
#define DATASET_DECLARE(name) extern const dataset_reader dataset_##name;
DATA_SETS(DATASET_DECLARE)

struct sherf_dataset {
    const dataset_reader *reader;
    char *root;
    int people;
    char **name;
    int train_listed,
        test_listed; /* HuMMan: the first people come from train.txt, the others from test.txt */
    bool listed;     /* human_list.txt gave the order */
    record_cache *cache;
};

/* ---- for readers ---- */
/* Cameras of cameras.json: NAME and the view's number in this many digits, up to the first gap. */
sherf_status cameras_json_read(context *c, const char *folder, const char *name, int digits,
                               person_record *r);
int dataset_find(const sherf_dataset *d, const char *name, size_t length); /* -1: missing */

/* ---- for the rest ---- */
/* The reader named in front of the path in "thuman:PATH", and the path; NULL: none is named. */
const dataset_reader *dataset_reader_named(const char *spec, const char **path);
void record_free(person_record *r);

sherf_status dataset_record(context *c, const sherf_dataset *d, int person, const person_record **out);
/* root/person[/file] */
sherf_status dataset_path(context *c, const sherf_dataset *d, int person, const char *file,
                          char out[PATH_LENGTH]);
sherf_status dataset_picture_paths(context *c, const sherf_dataset *d, int person, int pose, int view,
                                   char image[PATH_LENGTH], char mask[PATH_LENGTH]);
/* The file that holds the pose, and (may not exist) that of its world vertices; "" where a kind has none. */
sherf_status dataset_pose_paths(context *c, const sherf_dataset *d, int person, int pose,
                                char parameters[PATH_LENGTH], char vertices[PATH_LENGTH]);
#endif
