/* Dense kernels of the CPU backend. No include guard. */
CPU_KERNEL(linear)
CPU_KERNEL(conv2d)
CPU_KERNEL(conv2d_transpose)
CPU_KERNEL(fir_upsample)
CPU_KERNEL(demodulation)
CPU_KERNEL(scale_channels)
CPU_SHARED(normalize_moment) /* a vector, once a picture */
CPU_KERNEL(batch_norm)
CPU_KERNEL(bias_act)
CPU_KERNEL(max_pool)
CPU_KERNEL(average_pool)
CPU_KERNEL(add)
CPU_KERNEL(scale)
CPU_KERNEL(concat)
CPU_KERNEL(slice)
CPU_KERNEL(mask_rows)
CPU_SHARED(shift_scale) /* three channels of a picture */
