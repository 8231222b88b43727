/* Kernels defined in ref/spatial_*.inc. No include guard. */
