/* Kernels defined in ref/dense_*.inc. No include guard. */
REF_KERNEL(linear)
