/* The sheet that models read: an observation's picture, or several side by side in one (network.md, "Several
 * pictures"). A camera's projection is linear before the division by depth, and so is shifting a picture by
 * some pixels. So each picture's camera becomes an affine map into the world of one camera that sees them
 * all, and the maps of the body's vertices into the pictures stay affine. */
#include <math.h>
#include <string.h>

#include "model/model.h"

/* Pictures start at multiples of the encoders' strides, and far enough apart that no convolution over the
 * person sees the next one. */
enum { GRID = 32, SHEET_SIDE_MAX = 16384 };

static sherf_status picture_check(context *c, const observed_picture *p) {
    sherf_status status = camera_check(c, &p->camera);
    if (status != SHERF_OK) return status;
    if (p->image.channels != 3 || p->image.width != p->camera.width_px ||
        p->image.height != p->camera.height_px)
        return failure(c, SHERF_MISMATCH, "the picture is %d x %d x %d, the camera's is %d x %d x 3",
                       p->image.width, p->image.height, p->image.channels, p->camera.width_px,
                       p->camera.height_px);
    if (p->image.width < 32 || p->image.height < 32)
        return failure(c, SHERF_BAD_ARGUMENT, "the picture is %d x %d: at least 32 x 32 are needed",
                       p->image.width, p->image.height);
    return SHERF_OK;
}

static int up_to_grid(int n) {
    return (n + GRID - 1) / GRID * GRID;
}

/* Where each picture begins, and the sheet's size. */
static sherf_status lay_out(context *c, int count, const observed_picture *picture,
                            int left[OBSERVED_PICTURES_MAX], observed_sheet *out) {
    out->width = picture[0].image.width;
    out->height = picture[0].image.height;
    left[0] = 0;
    for (int i = 1; i < count; i++) {
        left[i] = up_to_grid(out->width) + up_to_grid(picture[i - 1].image.width / 8);
        out->width = left[i] + picture[i].image.width;
        if (out->height < picture[i].image.height) out->height = picture[i].image.height;
    }
    if (out->width <= SHEET_SIDE_MAX && out->height <= SHEET_SIDE_MAX) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "the pictures are %d pixels wide together: at most %d", out->width,
                   SHEET_SIDE_MAX);
}

static sherf_status draw(context *c, int count, const observed_picture *picture, const int *left,
                         observed_sheet *out) {
    out->image = mem_zero(c, (size_t)out->width * (size_t)out->height * 3, sizeof(float));
    if (!out->image) return SHERF_NO_MEMORY;
    for (int i = 0; i < count; i++) {
        const sherf_image *from = &picture[i].image;
        const size_t row = (size_t)from->width * 3;
        for (int y = 0; y < from->height; y++)
            memcpy(out->image + 3 * ((size_t)y * (size_t)out->width + (size_t)left[i]),
                   from->data + (size_t)y * row, row * sizeof(float));
    }
    return SHERF_OK;
}

/* In the sheet camera's world, a point of the picture's world is at K_sheet^-1 (K + left e_x row_3(K)) (R x +
 * T). */
static void into_sheet(const sherf_camera *from, int left, const sherf_camera *sheet, float map[12]) {
    const double f = (double)sheet->K[0];
    double K[9], view[12];
    for (int k = 0; k < 9; k++) K[k] = (double)from->K[k];
    for (int k = 0; k < 3; k++) K[k] += left * K[6 + k];
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 4; k++)
            view[4 * r + k] = k == 3 ? (double)from->T_m[r] : (double)from->R[3 * r + k];
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 4; k++) {
            double x = 0;
            for (int i = 0; i < 3; i++) x += K[3 * r + i] * view[4 * i + k];
            map[4 * r + k] = (float)(r < 2 ? x / f : x);
        }
}

static sherf_status pose_of(context *c, const model_config *config, const body_model *body,
                            const sherf_pose *pose, posed_body **out) {
    sherf_status status = posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, out);
    if (status == SHERF_OK) (*out)->blend_m = (float)config->skin_blend_mm / 1000;
    return status;
}

static sherf_status read_one(context *c, const model_config *config, const body_model *body,
                             observed_sheet *out) {
    const body_picture own = {out->body, &out->camera, out->image, NULL};
    return config->occlusion ? body_read_pictures(c, body, 1, &own, config->occlusion > 1, out->body)
                             : SHERF_OK;
}

static sherf_status read_several(context *c, const model_config *config, const body_model *body, int count,
                                 const observed_picture *picture, const int *left, observed_sheet *out) {
    body_picture part[OBSERVED_PICTURES_MAX];
    posed_body *posed[OBSERVED_PICTURES_MAX] = {NULL};
    float map[OBSERVED_PICTURES_MAX][12];
    const float f = picture[0].camera.K[0];
    sherf_status status = SHERF_OK;
    out->camera = (sherf_camera){.width_px = out->width, .height_px = out->height};
    out->camera.K[0] = out->camera.K[4] = f;
    out->camera.K[8] = out->camera.R[0] = out->camera.R[4] = out->camera.R[8] = 1;
    for (int i = 0; i < count && status == SHERF_OK; i++) {
        if (i) status = pose_of(c, config, body, &picture[i].pose, &posed[i]);
        into_sheet(&picture[i].camera, left[i], &out->camera, map[i]);
        part[i] = (body_picture){i ? posed[i] : out->body, &picture[i].camera, picture[i].image.data, map[i]};
    }
    if (status == SHERF_OK)
        status = body_read_pictures(c, body, count, part, config->occlusion > 1, out->body);
    for (int i = 0; i < count; i++) posed_body_free(posed[i]);
    return status;
}

sherf_status observed_sheet_create(context *c, const model_config *config, const body_model *body, int count,
                                   const observed_picture *picture, observed_sheet *out) {
    int left[OBSERVED_PICTURES_MAX];
    *out = (observed_sheet){0};
    sherf_status status = SHERF_OK;
    if (count < 1 || count > OBSERVED_PICTURES_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "%d pictures of a person: 1 to %d can be read", count,
                       OBSERVED_PICTURES_MAX);
    if (count > 1 && !config->kind->reads_observed_px)
        return failure(c, SHERF_UNSUPPORTED, "a %s takes one picture of a person, %d were given",
                       config->kind->name, count);
    for (int i = 0; i < count && status == SHERF_OK; i++) status = picture_check(c, &picture[i]);
    if (status == SHERF_OK) status = lay_out(c, count, picture, left, out);
    if (status == SHERF_OK) status = draw(c, count, picture, left, out);
    if (status == SHERF_OK) status = pose_of(c, config, body, &picture[0].pose, &out->body);
    out->camera = picture[0].camera;
    if (status == SHERF_OK)
        status = count == 1 ? read_one(c, config, body, out)
                            : read_several(c, config, body, count, picture, left, out);
    if (status != SHERF_OK) observed_sheet_free(out);
    return status;
}

void observed_sheet_free(observed_sheet *s) {
    mem_free(s->image);
    posed_body_free(s->body);
    *s = (observed_sheet){0};
}
