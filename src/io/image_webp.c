/* image: WebP through libwebp, its container's EXIF through libwebpdemux. */
#include <string.h>
#include <webp/decode.h>
#include <webp/demux.h>

#include "io/image_inside.h"

static const char *reason(VP8StatusCode code) {
    switch (code) {
    case VP8_STATUS_NOT_ENOUGH_DATA:
    case VP8_STATUS_SUSPENDED:
        return "it is cut off";
    case VP8_STATUS_UNSUPPORTED_FEATURE:
        return "of a kind that is not read";
    default:
        return "its data are broken";
    }
}

static void facts_from(image_decoder *d) {
    const WebPData all = {d->data, d->bytes};
    WebPChunkIterator chunk;
    WebPDemuxer *demuxer = WebPDemux(&all);
    if (demuxer && WebPDemuxGetChunk(demuxer, "EXIF", 1, &chunk)) {
        exif_read(chunk.chunk.bytes, chunk.chunk.size, &d->exif);
        WebPDemuxReleaseChunkIterator(&chunk);
    }
    if (demuxer && WebPDemuxGetChunk(demuxer, "ICCP", 1, &chunk)) {
        image_profile_take(d, chunk.chunk.bytes, chunk.chunk.size);
        WebPDemuxReleaseChunkIterator(&chunk);
    }
    WebPDemuxDelete(demuxer);
}

/* Decodes in place if the format matches, else through a second picture. */
static void decode_rows(image_decoder *d, WebPDecoderConfig *config) {
    const size_t width = (size_t)d->out.width, height = (size_t)d->out.height;
    const bool straight = !d->mask && d->channels >= 3;
    const size_t from = straight ? (size_t)d->channels : 3;
    if (!image_make_room(d, straight ? 0 : width * height * from)) return;
    config->output.colorspace = from == 4 ? MODE_RGBA : MODE_RGB;
    config->output.is_external_memory = 1;
    config->output.u.RGBA.rgba = straight ? d->out.data : d->row;
    config->output.u.RGBA.stride = (int)(width * from);
    config->output.u.RGBA.size = width * height * from;
    VP8StatusCode code = WebPDecode(d->data, d->bytes, config);
    if (code == VP8_STATUS_OUT_OF_MEMORY)
        d->status = failure(d->c, SHERF_NO_MEMORY, "out of memory");
    else if (code != VP8_STATUS_OK)
        d->status = image_broken(d, "WebP", reason(code));
    for (size_t y = 0; !d->status && !straight && y < height; y++)
        image_put_row(d, d->row + y * width * from, (int)y, (int)from);
}

void image_webp_decode(image_decoder *d) {
    WebPDecoderConfig config;
    if (!WebPInitDecoderConfig(&config)) {
        d->status = failure(d->c, SHERF_UNSUPPORTED, "WebP: libwebp is of another version");
        return;
    }
    VP8StatusCode code = WebPGetFeatures(d->data, d->bytes, &config.input);
    if (code != VP8_STATUS_OK)
        d->status = image_broken(d, "WebP", reason(code));
    else if (config.input.has_animation)
        d->status = failure(d->c, SHERF_BAD_FILE, "a moving WebP, of which no picture is read");
    else
        d->status = image_check_size(d, (uint64_t)config.input.width, (uint64_t)config.input.height);
    if (d->status) return;
    d->alpha = config.input.has_alpha;
    d->own_channels = d->alpha ? 4 : 3;
    facts_from(d);
    if (!d->status && d->channels) decode_rows(d, &config);
    WebPFreeDecBuffer(&config.output);
}
