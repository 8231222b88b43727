/* conv2d and conv2d_transpose through oneDNN, in float32 or, if it has that, bf16; call->in, out, din, dout
 * as in the op. */
#ifndef SHERF_DNNL_CONV_H
#define SHERF_DNNL_CONV_H

#include "tensor/cpu/cpu.h"

sherf_status dnnl_conv_forward(op_call *call, bool transpose, bool bf16);
sherf_status dnnl_conv_data(op_call *call, bool transpose, bool bf16);    /* adds to din[0] */
sherf_status dnnl_conv_weights(op_call *call, bool transpose, bool bf16); /* adds to din[1] */
#endif
