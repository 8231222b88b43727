/* The inside of a data set, shared by its two kinds of readers. */
#ifndef SHERF_DATA_DATASET_H
#define SHERF_DATA_DATASET_H

#include <pthread.h>

#include "base/path.h"
#include "data/view.h"

enum { DATASET_PEOPLE_MAX = 100000, DATASET_VIEWS_MAX = 10000, DATASET_POSES_MAX = 1000000 };

/* What is known of one person once anything of his is asked for. Never changes afterwards. */
typedef struct {
    int poses, views;
    parsed_camera *camera; /* views; T in metres */
    int *number;           /* THuman, ZJU-MoCap: poses; the number in the parameter files' names */
    char **image;          /* THuman, ZJU-MoCap: poses x views, below the person's folder; NULL: not there */
    sherf_pose *pose;      /* RenderPeople: poses */
    bool *present;         /* HuMMan: poses; frames are numbered as their files, with gaps */
} person_record;

typedef struct {
    pthread_mutex_t lock;
    person_record **record; /* by person; NULL: not read yet */
} record_cache;

struct sherf_dataset {
    data_kind kind;
    char *root;
    int people;
    char **name;
    int train_listed,
        test_listed; /* HuMMan: the first people come from train.txt, the others from test.txt */
    bool listed;     /* human_list.txt gave the order */
    record_cache *cache;
};

/* The reader of a layout: fills *r (zeroed) for the person in `folder`. */
sherf_status record_read_annots(context *c, data_kind kind, const char *folder, person_record *r);
sherf_status record_read_cameras_json(context *c, data_kind kind, const char *folder, person_record *r);
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
