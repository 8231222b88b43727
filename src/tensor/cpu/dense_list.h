/* Dense kernels of the CPU backend. No include guard. */
CPU_SHARED(linear)
