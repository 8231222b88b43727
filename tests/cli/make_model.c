/* make_model OUT: a small model with random weights, for installed.sh. */
#include <stdio.h>

#include <sherf/sherf.h>

int main(int count, char **argument) {
    sherf_context *c;
    sherf_model *model = NULL;
    if (count != 2 || sherf_context_create(NULL, &c)) return 2;
    sherf_status status = sherf_model_create(c, "small", 1, &model);
    if (!status) status = sherf_model_save(c, model, argument[1]);
    if (status) fprintf(stderr, "%s\n", sherf_message(c));
    sherf_model_free(model);
    sherf_context_free(c);
    return status != SHERF_OK;
}
