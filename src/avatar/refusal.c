/* Refusals of avatars: another body, or no network. They name the file that an avatar was loaded from. */
#include "avatar/avatar.h"

sherf_status avatar_named(context *c, const sherf_avatar *a, sherf_status status) {
    return a->path ? failure_prefix(c, status, "%s", a->path) : status;
}

sherf_status avatar_check_body(context *c, const sherf_avatar *a, const body_model *body) {
    if (body->fingerprint == a->body_fingerprint) return SHERF_OK;
    return avatar_named(c, a, failure(c, SHERF_MISMATCH, "the avatar was made with another body"));
}

sherf_status avatar_needs_network(context *c, const sherf_avatar *a, const char *what) {
    if (!a->form) return SHERF_OK;
    return avatar_named(c, a,
                        failure(c, SHERF_UNSUPPORTED,
                                "a %s avatar has no network: %s the avatar that it was made from",
                                a->form->name, what));
}
