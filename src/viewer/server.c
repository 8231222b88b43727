/* HTTP through libmicrohttpd: its single thread calls everything in this file but server_open, server_tend
 * and server_close. A request for a picture is suspended until the picture is ready. */
#include "viewer/viewer.h"

_Atomic double server_patience = 1;

#ifdef SHERF_HAVE_MICROHTTPD
#include <arpa/inet.h>
#include <cjson/cJSON.h>
#include <ifaddrs.h>
#include <microhttpd.h>
#include <netinet/in.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum {
    CONNECTIONS = 64,
    REQUEST_BYTES = 16384, /* a request's lines; also room to write an answer's */
    SILENCE_S = 15,        /* of a connection without traffic */
    FIRST_REQUEST_S = 10,  /* until a connection's first request has arrived, */
    REQUEST_S = 40,        /* and each further one, idle time included */
    ANSWER_S = 60,         /* until an answer has been read, */
    FILM_ANSWER_S = 1800   /* and a film, however slowly */
};

/* A connection, for server_tend. */
typedef struct {
    int fd;            /* -1: free */
    double deadline_s; /* 0: none while a picture is being made */
} slot;

struct viewer_server {
    viewer *v;
    struct MHD_Daemon *daemon;
    pthread_mutex_t lock; /* of the slots */
    slot slots[CONNECTIONS];
};

/* A request's data from its first line to its end. */
typedef struct {
    struct viewer_server *server;
    viewer_job *job;
} http_request;

/* ---- connections that take too long ---- */
static slot *slot_of(struct MHD_Connection *connection) {
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    return info ? info->socket_context : NULL;
}

static void deadline_set(struct viewer_server *s, struct MHD_Connection *connection, double seconds) {
    slot *at = slot_of(connection);
    if (!at) return;
    pthread_mutex_lock(&s->lock);
    at->deadline_s = seconds > 0 ? time_seconds() + server_patience * seconds : 0;
    pthread_mutex_unlock(&s->lock);
}

static void on_connection(void *cls, struct MHD_Connection *connection, void **own,
                          enum MHD_ConnectionNotificationCode code) {
    struct viewer_server *s = cls;
    pthread_mutex_lock(&s->lock);
    if (code == MHD_CONNECTION_NOTIFY_STARTED) {
        const union MHD_ConnectionInfo *info =
            MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
        *own = NULL;
        for (int i = 0; i < CONNECTIONS && info && !*own; i++)
            if (s->slots[i].fd < 0) {
                s->slots[i] = (slot){info->connect_fd, time_seconds() + server_patience * FIRST_REQUEST_S};
                *own = &s->slots[i];
            }
    } else if (*own) {
        ((slot *)*own)->fd = -1; /* before the socket closes: the number is not reused yet */
        *own = NULL;
    }
    pthread_mutex_unlock(&s->lock);
}

void server_tend(struct viewer_server *s) {
    double now = time_seconds();
    pthread_mutex_lock(&s->lock);
    for (int i = 0; i < CONNECTIONS; i++) {
        slot *at = &s->slots[i];
        if (at->fd < 0 || at->deadline_s == 0 || now < at->deadline_s) continue;
        shutdown(at->fd, SHUT_RDWR); /* the library sees the end, and closes */
        at->deadline_s = 0;
    }
    pthread_mutex_unlock(&s->lock);
}

/* ---- answers ---- */
static struct MHD_Response *with_headers(struct MHD_Response *r, const char *type) {
    static const char *const headers[][2] = {
        {"Cache-Control", "no-store"},
        {"X-Content-Type-Options", "nosniff"},
        {"X-Frame-Options", "DENY"},
        {"Referrer-Policy", "no-referrer"},
        {"Cross-Origin-Resource-Policy", "same-origin"},
        {"Cross-Origin-Opener-Policy", "same-origin"},
        {"Content-Security-Policy",
         "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
         "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"}};
    for (size_t i = 0; r && i < COUNT_OF(headers); i++)
        MHD_add_response_header(r, headers[i][0], headers[i][1]);
    if (r) MHD_add_response_header(r, "Content-Type", type);
    return r;
}

static enum MHD_Result send_off(struct MHD_Connection *connection, unsigned status, struct MHD_Response *r) {
    if (!r) return MHD_NO;
    enum MHD_Result result = MHD_queue_response(connection, status, r);
    MHD_destroy_response(r);
    return result;
}

static enum MHD_Result say(struct MHD_Connection *connection, unsigned status, const char *text) {
    char line[256];
    int n = snprintf(line, sizeof line, "%s\n", text);
    struct MHD_Response *r = MHD_create_response_from_buffer((size_t)n, line, MHD_RESPMEM_MUST_COPY);
    return send_off(connection, status, with_headers(r, "text/plain; charset=utf-8"));
}

/* Refuses and closes the connection. */
static enum MHD_Result refuse(struct MHD_Connection *connection, unsigned status, const char *text) {
    char line[256];
    int n = snprintf(line, sizeof line, "%s\n", text);
    struct MHD_Response *r = MHD_create_response_from_buffer((size_t)n, line, MHD_RESPMEM_MUST_COPY);
    if (r) MHD_add_response_header(r, "Connection", "close");
    return send_off(connection, status, with_headers(r, "text/plain; charset=utf-8"));
}

static enum MHD_Result send_json(struct MHD_Connection *connection, cJSON *json) {
    char *text = json ? cJSON_PrintUnformatted(json) : NULL;
    cJSON_Delete(json);
    struct MHD_Response *r =
        text ? MHD_create_response_from_buffer(strlen(text), text, MHD_RESPMEM_MUST_COPY) : NULL;
    cJSON_free(text);
    return send_off(connection, MHD_HTTP_OK, with_headers(r, "application/json"));
}

/* Takes over `data`. */
static struct MHD_Response *of_memory(uint8_t *data, size_t bytes, const char *type) {
    struct MHD_Response *r = MHD_create_response_from_buffer_with_free_callback(bytes, data, mem_free);
    if (!r) mem_free(data);
    return with_headers(r, type);
}

static void header_number(struct MHD_Response *r, const char *name, double value) {
    char text[32];
    snprintf(text, sizeof text, "%.6g", value);
    if (r) MHD_add_response_header(r, name, text);
}

/* ---- requests ---- */
static enum MHD_Result take_field(void *cls, enum MHD_ValueKind kind, const char *name, const char *value) {
    viewer_query *q = cls;
    return query_take(q, name, value) ? MHD_YES : MHD_NO;
}

/* False: the query is not valid, and `wrong` in it says why. */
static bool query_read(struct MHD_Connection *connection, const viewer *v, viewer_query *q) {
    query_start(q);
    MHD_get_connection_values(connection, MHD_GET_ARGUMENT_KIND, take_field, q);
    if (*q->wrong) return false;
    const char *misfit = request_misfit(&v->scene, &q->request);
    snprintf(q->wrong, sizeof q->wrong, "%s", misfit ? misfit : "");
    return !misfit;
}

/* The same of a request that must say whose it is. */
static bool client_query_read(struct MHD_Connection *connection, const viewer *v, viewer_query *q) {
    if (!query_read(connection, v, q)) return false;
    if (!q->client[0]) snprintf(q->wrong, sizeof q->wrong, "client: it is missing");
    return q->client[0];
}

static enum MHD_Result say_wrong(struct MHD_Connection *connection, const viewer_query *q) {
    return say(connection, MHD_HTTP_BAD_REQUEST, q->wrong);
}

static void wake(void *connection) {
    MHD_resume_connection(connection);
}

static enum MHD_Result frame_send(http_request *r, struct MHD_Connection *connection) {
    viewer_job *job = r->job; /* done: nobody else changes it */
    struct MHD_Response *response;
    switch (job->state) {
    case JOB_DONE:
        response = of_memory(job->data, job->bytes, job->png ? "image/png" : "image/jpeg");
        job->data = NULL;
        header_number(response, "X-Render-Ms", 1e3 * job->render_s);
        header_number(response, "X-Points", (double)job->points);
        header_number(response, "X-Scale", job->scale_m);
        if (job->baked) header_number(response, "X-Baked", 1);
        return send_off(connection, MHD_HTTP_OK, response);
    case JOB_REPLACED:
        response = with_headers(MHD_create_response_from_buffer(0, "", MHD_RESPMEM_PERSISTENT), "text/plain");
        return send_off(connection, MHD_HTTP_NO_CONTENT, response);
    case JOB_CLOSED:
        return refuse(connection, MHD_HTTP_SERVICE_UNAVAILABLE, "the viewer is ending");
    default:
        return say(connection, MHD_HTTP_INTERNAL_SERVER_ERROR, job->message);
    }
}

static enum MHD_Result frame_handle(http_request *r, struct MHD_Connection *connection) {
    viewer *v = r->server->v;
    viewer_query q;
    if (!client_query_read(connection, v, &q)) return say_wrong(connection, &q);
    switch (desk_admit(&v->desk, &q, &r->job)) {
    case ADMITTED:
        break;
    case ADMITTED_NO_SEAT:
        return say(connection, MHD_HTTP_SERVICE_UNAVAILABLE, "too many viewers at once");
    case ADMITTED_TOO_MANY:
        return say(connection, MHD_HTTP_TOO_MANY_REQUESTS, "too many requests at once");
    case ADMITTED_NO_MEMORY:
        return say(connection, MHD_HTTP_INTERNAL_SERVER_ERROR, "out of memory");
    }
    deadline_set(r->server, connection, 0);
    MHD_suspend_connection(connection);
    desk_submit(&v->desk, r->job, wake, connection);
    return MHD_YES;
}

static enum MHD_Result picture_send(http_request *r, struct MHD_Connection *connection) {
    context quiet = {0};
    viewer_query q;
    uint8_t *data;
    size_t bytes;
    if (!query_read(connection, r->server->v, &q)) return say_wrong(connection, &q);
    const sherf_status status = scene_picture(&quiet, &r->server->v->scene, q.request.avatar, &data, &bytes);
    if (status == SHERF_UNSUPPORTED) return say(connection, MHD_HTTP_NOT_FOUND, quiet.message);
    if (status != SHERF_OK) return say(connection, MHD_HTTP_INTERNAL_SERVER_ERROR, "out of memory");
    return send_off(connection, MHD_HTTP_OK, of_memory(data, bytes, "image/png"));
}

/* ---- what the page draws itself ---- */
static enum MHD_Result surface_send(http_request *r, struct MHD_Connection *connection) {
    viewer_query q;
    const uint8_t *data;
    size_t bytes;
    if (!query_read(connection, r->server->v, &q)) return say_wrong(connection, &q);
    switch (live_ask(r->server->v, q.request.avatar, &data, &bytes)) {
    case LIVE_READY: {
        const struct MHD_IoVec whole = {data, bytes};
        struct MHD_Response *surface = MHD_create_response_from_iovec(&whole, 1, NULL, NULL);
        return send_off(connection, MHD_HTTP_OK, with_headers(surface, "application/octet-stream"));
    }
    case LIVE_FAILED:
        return say(connection, MHD_HTTP_NOT_FOUND, "this avatar has no surface");
    default:
        return say(connection, MHD_HTTP_ACCEPTED, "it is being made");
    }
}

static enum MHD_Result moves_send(http_request *r, struct MHD_Connection *connection) {
    context quiet = {.threads = 1};
    viewer_query q;
    uint8_t *data;
    size_t bytes;
    if (!query_read(connection, r->server->v, &q)) return say_wrong(connection, &q);
    if (live_moves(&quiet, &r->server->v->scene, q.request.avatar, q.request.motion, q.request.frame, &data,
                   &bytes) != SHERF_OK)
        return say(connection, MHD_HTTP_INTERNAL_SERVER_ERROR, quiet.message);
    return send_off(connection, MHD_HTTP_OK, of_memory(data, bytes, "application/octet-stream"));
}

/* ---- films ---- */
static enum MHD_Result film_state_send(http_request *r, struct MHD_Connection *connection,
                                       const viewer_query *q) {
    static const char *const names[] = {"none", "running", "done", "failed"};
    viewer_desk *d = &r->server->v->desk;
    pthread_mutex_lock(&d->lock);
    int seat = desk_seat(d, q->client);
    cJSON *json = cJSON_CreateObject();
    if (seat >= 0) {
        const viewer_film *f = &d->client[seat].film;
        cJSON_AddStringToObject(json, "state", names[f->state]);
        cJSON_AddNumberToObject(json, "done", f->done);
        cJSON_AddNumberToObject(json, "frames", f->frames);
        cJSON_AddNumberToObject(json, "bytes", (double)f->bytes);
        if (f->state == FILM_FAILED) cJSON_AddStringToObject(json, "message", f->message);
    }
    pthread_mutex_unlock(&d->lock);
    if (seat < 0) {
        cJSON_Delete(json);
        return say(connection, MHD_HTTP_SERVICE_UNAVAILABLE, "too many viewers at once");
    }
    return send_json(connection, json);
}

static enum MHD_Result film_change(http_request *r, struct MHD_Connection *connection, const viewer_query *q,
                                   bool start) {
    viewer *v = r->server->v;
    pthread_mutex_lock(&v->desk.lock);
    int seat = desk_seat(&v->desk, q->client);
    const char *wrong = seat < 0 ? "too many viewers at once" : NULL;
    if (!wrong && start)
        wrong = film_start(v, seat, q);
    else if (!wrong)
        film_drop(v, seat);
    pthread_mutex_unlock(&v->desk.lock);
    return wrong ? say(connection, MHD_HTTP_CONFLICT, wrong) : say(connection, MHD_HTTP_OK, "well");
}

static enum MHD_Result film_handle(http_request *r, struct MHD_Connection *connection, const char *method) {
    viewer_query q;
    if (!client_query_read(connection, r->server->v, &q)) return say_wrong(connection, &q);
    if (strcmp(method, MHD_HTTP_METHOD_POST) == 0) return film_change(r, connection, &q, true);
    if (strcmp(method, MHD_HTTP_METHOD_DELETE) == 0) return film_change(r, connection, &q, false);
    return film_state_send(r, connection, &q);
}

static enum MHD_Result film_file_send(http_request *r, struct MHD_Connection *connection) {
    viewer_desk *d = &r->server->v->desk;
    viewer_query q;
    int fd = -1;
    int64_t bytes = 0;
    if (!client_query_read(connection, r->server->v, &q)) return say_wrong(connection, &q);
    pthread_mutex_lock(&d->lock);
    int seat = desk_seat(d, q.client);
    if (seat >= 0 && d->client[seat].film.state == FILM_DONE) {
        fd = dup(d->client[seat].film.fd);
        bytes = d->client[seat].film.bytes;
    }
    pthread_mutex_unlock(&d->lock);
    if (fd < 0) return say(connection, MHD_HTTP_NOT_FOUND, "there is no film");
    struct MHD_Response *response = MHD_create_response_from_fd_at_offset64((uint64_t)bytes, fd, 0);
    if (!response) close(fd);
    with_headers(response, "video/mp4");
    if (response)
        MHD_add_response_header(response, "Content-Disposition", "attachment; filename=\"sherf.mp4\"");
    deadline_set(r->server, connection, FILM_ANSWER_S);
    return send_off(connection, MHD_HTTP_OK, response);
}

/* ---- the course of a request ---- */
static const char *header(struct MHD_Connection *connection, const char *name) {
    return MHD_lookup_connection_value(connection, MHD_HEADER_KIND, name);
}

/* NULL, or why the request is refused. *rest: the path after the token. */
static const char *guard(struct viewer_server *s, struct MHD_Connection *connection, const char *path,
                         const char **rest, unsigned *status) {
    const char *host = header(connection, "Host"), *site = header(connection, "Sec-Fetch-Site"),
               *length = header(connection, "Content-Length");
    *status = MHD_HTTP_FORBIDDEN;
    if (!host_is_allowed(host))
        return "this name is not served here: use the address that sherf view printed";
    if (!origin_is_allowed(header(connection, "Origin"), host)) return "not from a page of another site";
    if (!token_matches(s->v->token, path, rest))
        return "open the address that sherf view printed: it ends in a key";
    if (site && strcmp(site, "same-origin") != 0 && strcmp(site, "none") != 0 && strcmp(*rest, "/") != 0)
        return "not from a page of another site";
    *status = MHD_HTTP_CONTENT_TOO_LARGE;
    if ((length && strcmp(length, "0") != 0) || header(connection, "Transfer-Encoding"))
        return "requests have no body here";
    return NULL;
}

static enum MHD_Result route(http_request *r, struct MHD_Connection *connection, const char *rest,
                             const char *method) {
    viewer *v = r->server->v;
    bool get = strcmp(method, MHD_HTTP_METHOD_GET) == 0 || strcmp(method, MHD_HTTP_METHOD_HEAD) == 0;
    deadline_set(r->server, connection, ANSWER_S);
    if (strcmp(rest, "/film") == 0 &&
        (get || strcmp(method, MHD_HTTP_METHOD_POST) == 0 || strcmp(method, MHD_HTTP_METHOD_DELETE) == 0))
        return film_handle(r, connection, method);
    if (!get) return refuse(connection, MHD_HTTP_METHOD_NOT_ALLOWED, "not with this method");
    if (strcmp(rest, "/frame") == 0) return frame_handle(r, connection);
    if (strcmp(rest, "/picture") == 0) return picture_send(r, connection);
    if (strcmp(rest, "/surface") == 0) return surface_send(r, connection);
    if (strcmp(rest, "/moves") == 0) return moves_send(r, connection);
    if (strcmp(rest, "/film.mp4") == 0) return film_file_send(r, connection);
    if (strcmp(rest, "/about") == 0) {
        struct MHD_Response *about =
            MHD_create_response_from_buffer(strlen(v->scene.about), v->scene.about, MHD_RESPMEM_PERSISTENT);
        return send_off(connection, MHD_HTTP_OK, with_headers(about, "application/json"));
    }
    if (!*rest) { /* the page uses relative addresses */
        char to[VIEWER_TOKEN + 3];
        snprintf(to, sizeof to, "/%s/", v->token);
        struct MHD_Response *moved = MHD_create_response_from_buffer(0, "", MHD_RESPMEM_PERSISTENT);
        if (moved) MHD_add_response_header(moved, "Location", to);
        return send_off(connection, MHD_HTTP_FOUND, with_headers(moved, "text/plain"));
    }
    for (int i = 0; i < viewer_file_count; i++) {
        const viewer_file *f = &viewer_files[i];
        if (strcmp(rest + 1, i == 0 ? "" : f->name) != 0) continue;
        const struct MHD_IoVec whole = {f->data, f->bytes};
        struct MHD_Response *file = MHD_create_response_from_iovec(&whole, 1, NULL, NULL);
        return send_off(connection, MHD_HTTP_OK, with_headers(file, f->type));
    }
    return say(connection, MHD_HTTP_NOT_FOUND, "there is nothing here");
}

/* Called when a request's lines have been read, and again until it has an answer. */
static enum MHD_Result on_request(void *cls, struct MHD_Connection *connection, const char *path,
                                  const char *method, const char *version, const char *upload, size_t *bytes,
                                  void **own) {
    struct viewer_server *s = cls;
    const char *rest;
    http_request *r = *own;
    if (!r) {
        unsigned status;
        const char *wrong = guard(s, connection, path, &rest, &status);
        if (wrong) return refuse(connection, status, wrong);
        context quiet = {0};
        *own = r = mem_zero(&quiet, 1, sizeof *r);
        if (!r) return MHD_NO;
        r->server = s;
        return MHD_YES;
    }
    if (*bytes) return MHD_NO;
    if (r->job) {
        deadline_set(s, connection, ANSWER_S);
        return frame_send(r, connection);
    }
    token_matches(s->v->token, path, &rest);
    return route(r, connection, rest, method);
}

static void on_end(void *cls, struct MHD_Connection *connection, void **own,
                   enum MHD_RequestTerminationCode code) {
    struct viewer_server *s = cls;
    http_request *r = *own;
    deadline_set(s, connection, REQUEST_S);
    if (r && r->job) desk_release(&s->v->desk, r->job);
    mem_free(r);
    *own = NULL;
}

static void say_nothing(void *cls, const char *format, va_list list) {
    (void)cls;
    (void)format;
    (void)list;
}

/* ---- opening and closing ---- */
typedef union {
    struct sockaddr any;
    struct sockaddr_in v4;
    struct sockaddr_in6 v6;
} socket_address;

static bool address_parse(const char *text, int port, socket_address *out) {
    *out = (socket_address){0};
    if (inet_pton(AF_INET, text, &out->v4.sin_addr) == 1) {
        out->v4.sin_family = AF_INET;
        out->v4.sin_port = htons((uint16_t)port);
        return true;
    }
    if (inet_pton(AF_INET6, text, &out->v6.sin6_addr) != 1) return false;
    out->v6.sin6_family = AF_INET6;
    out->v6.sin6_port = htons((uint16_t)port);
    return true;
}

/* The machine's first address that others can reach, or the loopback. */
static void own_address(char *out, size_t size) {
    struct ifaddrs *list = NULL;
    snprintf(out, size, "127.0.0.1");
    if (getifaddrs(&list)) return;
    for (const struct ifaddrs *i = list; i; i = i->ifa_next) {
        if (!i->ifa_addr || i->ifa_addr->sa_family != AF_INET) continue;
        const struct sockaddr_in *a = (const struct sockaddr_in *)(const void *)i->ifa_addr;
        if ((ntohl(a->sin_addr.s_addr) >> 24) == 127) continue;
        inet_ntop(AF_INET, &a->sin_addr, out, (socklen_t)size);
        break;
    }
    freeifaddrs(list);
}

static void address_print(viewer *v, const char *listen, int port) {
    char any[64];
    bool all = strcmp(listen, "0.0.0.0") == 0 || strcmp(listen, "::") == 0;
    if (all) own_address(any, sizeof any);
    const char *host = all ? any : listen;
    snprintf(v->address, sizeof v->address,
             strchr(host, ':') ? "http://[%.64s]:%d/%s/" : "http://%.64s:%d/%s/", host, port, v->token);
}

sherf_status server_open(context *c, viewer *v, const char *listen, int port) {
    socket_address address;
    if (!listen) listen = "127.0.0.1";
    if (port < 0 || port > 65535 || !address_parse(listen, port, &address))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "viewer: cannot listen at %.64s, port %d: not an address in figures", listen, port);
    struct viewer_server *s = v->server = mem_zero(c, 1, sizeof *s);
    if (!s) return SHERF_NO_MEMORY;
    s->v = v;
    for (int i = 0; i < CONNECTIONS; i++) s->slots[i].fd = -1;
    pthread_mutex_init(&s->lock, NULL);
    unsigned flags = MHD_USE_AUTO | MHD_USE_INTERNAL_POLLING_THREAD | MHD_ALLOW_SUSPEND_RESUME |
                     (address.any.sa_family == AF_INET6 ? MHD_USE_IPv6 : 0);
    s->daemon = MHD_start_daemon(flags, 0, NULL, NULL, on_request, s, MHD_OPTION_EXTERNAL_LOGGER, say_nothing,
                                 NULL, MHD_OPTION_SOCK_ADDR, &address.any, MHD_OPTION_CONNECTION_LIMIT,
                                 (unsigned)CONNECTIONS, MHD_OPTION_CONNECTION_MEMORY_LIMIT,
                                 (size_t)REQUEST_BYTES, MHD_OPTION_CONNECTION_TIMEOUT, (unsigned)SILENCE_S,
                                 MHD_OPTION_NOTIFY_COMPLETED, on_end, s, MHD_OPTION_NOTIFY_CONNECTION,
                                 on_connection, s, MHD_OPTION_STRICT_FOR_CLIENT, 1, MHD_OPTION_END);
    const union MHD_DaemonInfo *info =
        s->daemon ? MHD_get_daemon_info(s->daemon, MHD_DAEMON_INFO_BIND_PORT) : NULL;
    if (!info)
        return failure(c, SHERF_UNSUPPORTED,
                       "viewer: cannot listen at %.64s, port %d: taken, or not this machine's", listen, port);
    address_print(v, listen, info->port);
    return SHERF_OK;
}

void server_close(struct viewer_server *s) {
    if (!s) return;
    if (s->daemon) MHD_stop_daemon(s->daemon);
    pthread_mutex_destroy(&s->lock);
    mem_free(s);
}

#else
struct viewer_server {
    int none;
};

sherf_status server_open(context *c, viewer *v, const char *listen, int port) {
    return failure(c, SHERF_UNSUPPORTED,
                   "this build has no viewer: libmicrohttpd-dev was missing when it was configured");
}
void server_tend(struct viewer_server *s) {
    (void)s;
}
void server_close(struct viewer_server *s) {
    (void)s;
}
#endif
