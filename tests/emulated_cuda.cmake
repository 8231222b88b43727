# Compiles the kernels of src/tensor/cuda, src/sampling/cuda and src/model/sherf/cuda as plain C++, to run on the host
# (support/cuda), if there is a C++ compiler. It must be of the C compiler's family, because two families' sanitizers do
# not mix.
if(NOT CMAKE_CXX_COMPILER AND CMAKE_C_COMPILER_ID MATCHES Clang)
  find_program(CLANGXX NAMES clang++)
  if(CLANGXX)
    set(CMAKE_CXX_COMPILER ${CLANGXX})
  endif()
endif()
include(CheckLanguage)
check_language(CXX)
if(NOT CMAKE_CXX_COMPILER)
  message(STATUS "there is no C++ compiler: the CUDA kernels are not tested on the host")
  return()
endif()
enable_language(CXX)
file(GLOB SHERF_CUDA_KERNELS CONFIGURE_DEPENDS ${CMAKE_SOURCE_DIR}/src/tensor/cuda/*.cu
     ${CMAKE_SOURCE_DIR}/src/sampling/cuda/*.cu ${CMAKE_SOURCE_DIR}/src/model/sherf/cuda/*.cu)
# Code that calls the CUDA runtime and libraries is replaced by support/cuda.
list(FILTER SHERF_CUDA_KERNELS EXCLUDE REGEX "/(runtime|product|group|frame_runtime)\\.cu$")
set_source_files_properties(${SHERF_CUDA_KERNELS} PROPERTIES LANGUAGE CXX COMPILE_OPTIONS "-xc++")
add_library(cuda_emulated STATIC ${SHERF_CUDA_KERNELS} support/cuda/cuda_emulated.cpp support/cuda/group_emulated.cpp)
set_target_properties(cuda_emulated PROPERTIES CXX_STANDARD 17 CXX_EXTENSIONS ON)
target_include_directories(cuda_emulated PRIVATE ${CMAKE_SOURCE_DIR}/include ${CMAKE_SOURCE_DIR}/src support/cuda)
target_compile_definitions(cuda_emulated PRIVATE CUDA_EMULATED cuda_backend=emulated_backend
  backend_cuda=backend_emulated
                           gpu_renderer_cuda=gpu_renderer_emulated)
target_compile_options(cuda_emulated PRIVATE -O2 -ffp-contract=off)
if(SHERF_MPI)
  target_compile_definitions(cuda_emulated PRIVATE SHERF_HAVE_MPI)
endif()
target_link_libraries(cuda_emulated PUBLIC sherf_static)
target_compile_definitions(cuda_emulated INTERFACE HAVE_CUDA_EMULATED)
