/* The ops this backend has: CUDA_KERNEL(op) both passes, CUDA_FORWARD(op) the forward one. No include guard.
 */
CUDA_KERNEL(bias_act)
CUDA_KERNEL(add)
CUDA_KERNEL(scale)
CUDA_KERNEL(mask_rows)
CUDA_KERNEL(shift_scale)
CUDA_KERNEL(gelu)
CUDA_KERNEL(sigmoid)
CUDA_FORWARD(positional_encode)
