/* Spatial kernels of the CPU backend. No include guard. */
CPU_KERNEL(sample_bilinear)
CPU_SHARED(scatter_mean) /* a body's vertices, once a step */
CPU_KERNEL(sparse_conv)
CPU_KERNEL(sample_trilinear)
CPU_KERNEL(layer_norm)
CPU_KERNEL(token_attention)
CPU_KERNEL(gelu)
CPU_KERNEL(sigmoid)
CPU_FORWARD(positional_encode)
CPU_KERNEL(composite)
CPU_KERNEL(mean_square)
CPU_KERNEL(ssim)
CPU_KERNEL(feature_distance)
