# The CUDA backend: *.cu in src/tensor/cuda, src/sampling/cuda and src/model/sherf/cuda. The runtime is linked
# statically and cuBLAS is opened on first use, so one build runs with and without a GPU, its driver and the toolkit.
enable_language(CUDA)
if(CMAKE_CUDA_COMPILER_VERSION VERSION_LESS 12)
  message(FATAL_ERROR "SHERF_CUDA needs nvcc 12 or newer, and this is ${CMAKE_CUDA_COMPILER_VERSION}")
endif()
find_package(CUDAToolkit REQUIRED)
set(SHERF_CUDA_ARCHITECTURES 80-real 90 CACHE STRING "compute capabilities of the CUDA backend")
file(GLOB SHERF_CUDA_SOURCES CONFIGURE_DEPENDS src/tensor/cuda/*.cu src/sampling/cuda/*.cu
     src/model/sherf/cuda/*.cu)
add_library(sherf_cuda OBJECT ${SHERF_CUDA_SOURCES})
set_target_properties(sherf_cuda PROPERTIES CUDA_STANDARD 17 CUDA_ARCHITECTURES "${SHERF_CUDA_ARCHITECTURES}"
                                            CUDA_RUNTIME_LIBRARY Static POSITION_INDEPENDENT_CODE ON)
target_compile_options(sherf_cuda PRIVATE --extended-lambda
  -Xcompiler=-Wall,-Wextra,-Wno-unused-parameter,-fvisibility=hidden)
if(SHERF_WERROR)
  target_compile_options(sherf_cuda PRIVATE -Werror=all-warnings)
endif()
target_include_directories(sherf_cuda PRIVATE include src ${CUDAToolkit_INCLUDE_DIRS})
# Geometry is the same to the last bit as on the CPU: no fused operations.
set_source_files_properties(src/sampling/cuda/posing.cu src/sampling/cuda/points.cu
  PROPERTIES COMPILE_OPTIONS --fmad=false)
set_source_files_properties(src/base/device.c src/tensor/backend.c src/model/sherf/fused/gpu.c PROPERTIES
  COMPILE_DEFINITIONS
                            SHERF_HAVE_CUDA)
target_link_libraries(sherf_needs INTERFACE CUDA::cudart_static stdc++)
set(SHERF_CUDA_LIBS " -L${CUDAToolkit_LIBRARY_DIR} -lcudart_static -lstdc++ -ldl -lrt -lpthread") # for sherf.pc
list(APPEND SHERF_OBJECTS $<TARGET_OBJECTS:sherf_cuda>) # part of the library, besides sherf_objects
set(SHERF_TESTS_DEFINE SHERF_HAVE_CUDA)
