/* lpips_file: the weights of LPIPS from converted files. */
#ifndef SHERF_LPIPS_FILE_H
#define SHERF_LPIPS_FILE_H

#include "nn/lpips.h"

/* paths: one file with VGG16 and heads, or several with commas between, looked through in order. VGG16's
 * tensors are features.N.weight and .bias (or net.sliceS.N.*, as in the whole distance's file), the heads
 * lin0 to lin4 (lin0.model.1.weight). */
sherf_status lpips_load(context *c, const char *paths, lpips_network **out);

#endif
