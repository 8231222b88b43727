# Installs libsherf.so and libsherf.a, which export only the sherf_ names, the program, the header, the files
# for pkg-config and find_package, man pages, completion and assets.
add_library(sherf_shared SHARED ${SHERF_OBJECTS})
set_target_properties(sherf_shared PROPERTIES OUTPUT_NAME sherf VERSION ${PROJECT_VERSION} SOVERSION 0)
set_property(TARGET sherf_shared PROPERTY EXPORT_NAME sherf)
target_include_directories(sherf_shared INTERFACE $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
target_link_libraries(sherf_shared PRIVATE sherf_needs)
target_link_options(sherf_shared PRIVATE LINKER:--no-undefined
                    LINKER:--version-script=${CMAKE_SOURCE_DIR}/cmake/sherf.map)
set_property(TARGET sherf_shared PROPERTY LINK_DEPENDS ${CMAKE_SOURCE_DIR}/cmake/sherf.map)
if(SHERF_SANITIZE)
  # The sanitizers' own names are resolved in the program, and their sections do not survive the next step.
  set_property(TARGET sherf_shared PROPERTY LINK_OPTIONS)
  set(SHERF_ARCHIVE $<TARGET_FILE:sherf_static>)
  add_custom_target(sherf_archive DEPENDS sherf_static)
else()
  # One object in which every hidden name is local (and so are the locks of named critical sections, which gcc
  # makes visible common symbols).
  set(SHERF_ARCHIVE ${CMAKE_BINARY_DIR}/libsherf.a)
  add_custom_command(
    OUTPUT ${SHERF_ARCHIVE}
    COMMAND ${CMAKE_LINKER} -r -d -o sherf_whole.o ${SHERF_OBJECTS}
    COMMAND ${CMAKE_OBJCOPY} --localize-hidden --wildcard --localize-symbol=.gomp_critical_user_* sherf_whole.o
    COMMAND ${CMAKE_COMMAND} -E rm -f ${SHERF_ARCHIVE}
    COMMAND ${CMAKE_AR} rcs ${SHERF_ARCHIVE} sherf_whole.o
    DEPENDS sherf_objects ${SHERF_OBJECTS}
    COMMAND_EXPAND_LISTS VERBATIM)
  add_custom_target(sherf_archive DEPENDS ${SHERF_ARCHIVE})
endif()

# The program is linked with that archive and sees only include/, so it can use only the public API.
file(GLOB SHERF_CLI CONFIGURE_DEPENDS cli/*.c)
add_executable(sherf ${SHERF_CLI})
add_dependencies(sherf sherf_archive)
target_include_directories(sherf PRIVATE include)
target_compile_definitions(sherf PRIVATE SHERF_ASSETS_FOLDER="${CMAKE_INSTALL_FULL_DATADIR}/sherf")
if(SHERF_CUDA)
  target_compile_definitions(sherf PRIVATE SHERF_HAVE_CUDA)
endif()
target_link_libraries(sherf PRIVATE ${SHERF_ARCHIVE} sherf_needs)
set_property(TARGET sherf PROPERTY LINK_DEPENDS ${SHERF_ARCHIVE})

# Man pages and completion come from the program's own option tables.
file(GLOB verbs RELATIVE ${CMAKE_SOURCE_DIR}/cli CONFIGURE_DEPENDS cli/cmd_*.c)
list(TRANSFORM verbs REPLACE "^cmd_(.*)\\.c$" "\\1")
set(texts ${CMAKE_BINARY_DIR}/texts)
set(pages ${texts}/sherf.1)
set(commands COMMAND sherf --describe man > sherf.1)
foreach(verb ${verbs})
  list(APPEND pages ${texts}/sherf-${verb}.1)
  list(APPEND commands COMMAND sherf --describe man-${verb} > sherf-${verb}.1)
endforeach()
file(MAKE_DIRECTORY ${texts})
add_custom_command(
  OUTPUT ${pages} ${texts}/sherf.bash ${texts}/_sherf
  ${commands}
  COMMAND sherf --describe bash > sherf.bash
  COMMAND sherf --describe zsh > _sherf
  WORKING_DIRECTORY ${texts}
  DEPENDS sherf)
add_custom_target(sherf_texts ALL DEPENDS ${pages} ${texts}/sherf.bash ${texts}/_sherf)

# pkg-config: the additional libraries of a static link.
list(JOIN SHERF_PKG_CONFIG ", " SHERF_REQUIRES_PRIVATE)
list(GET OpenMP_C_LIBRARIES 0 SHERF_OPENMP) # the library rather than the flag, which another compiler may not know
if(CMAKE_C_COMPILER_ID STREQUAL GNU)
  set(SHERF_OPENMP -lgomp) # in a folder of the compiler's version
endif()
# Relative to sherf.pc, so that it is right after `cmake --install --prefix` too; pkg-config quotes spaces in it.
foreach(folder LIBDIR INCLUDEDIR)
  set(SHERF_PC_${folder} "\${prefix}/${CMAKE_INSTALL_${folder}}")
  if(IS_ABSOLUTE "${CMAKE_INSTALL_${folder}}")
    set(SHERF_PC_${folder} "${CMAKE_INSTALL_${folder}}")
  endif()
endforeach()
set(SHERF_PC_PREFIX "${CMAKE_INSTALL_PREFIX}")
if(NOT IS_ABSOLUTE "${CMAKE_INSTALL_LIBDIR}")
  file(RELATIVE_PATH SHERF_PC_PREFIX "/${CMAKE_INSTALL_LIBDIR}/pkgconfig" /)
  string(REGEX REPLACE "/$" "" SHERF_PC_PREFIX "\${pcfiledir}/${SHERF_PC_PREFIX}")
endif()
set(SHERF_LIBS_PRIVATE "-ldnnl -lembree3 -lm ${SHERF_OPENMP}${SHERF_CUDA_LIBS}")
configure_file(cmake/sherf.pc.in ${CMAKE_BINARY_DIR}/sherf.pc @ONLY)

# find_package(sherf), also relative to its own file.
include(CMakePackageConfigHelpers)
set(SHERF_CMAKE_FOLDER ${CMAKE_INSTALL_LIBDIR}/cmake/sherf)
set(SHERF_ASSETS ${CMAKE_INSTALL_DATADIR}/sherf)
set(SHERF_PROGRAM ${CMAKE_INSTALL_BINDIR}/sherf)
string(REPLACE " " ";" SHERF_STATIC_LIBS "${SHERF_LIBS_PRIVATE}")
configure_package_config_file(
  cmake/sherfConfig.cmake.in ${CMAKE_BINARY_DIR}/sherfConfig.cmake INSTALL_DESTINATION ${SHERF_CMAKE_FOLDER}
  PATH_VARS SHERF_ASSETS SHERF_PROGRAM CMAKE_INSTALL_LIBDIR CMAKE_INSTALL_INCLUDEDIR)
write_basic_package_version_file(${CMAKE_BINARY_DIR}/sherfConfigVersion.cmake COMPATIBILITY SameMinorVersion)

install(TARGETS sherf RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
install(TARGETS sherf_shared EXPORT sherfTargets LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(EXPORT sherfTargets NAMESPACE sherf:: DESTINATION ${SHERF_CMAKE_FOLDER})
install(FILES ${CMAKE_BINARY_DIR}/sherfConfig.cmake ${CMAKE_BINARY_DIR}/sherfConfigVersion.cmake
        DESTINATION ${SHERF_CMAKE_FOLDER})
install(FILES ${SHERF_ARCHIVE} DESTINATION ${CMAKE_INSTALL_LIBDIR} RENAME libsherf.a)
install(FILES include/sherf/sherf.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/sherf)
install(FILES ${CMAKE_BINARY_DIR}/sherf.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
install(FILES ${pages} DESTINATION ${CMAKE_INSTALL_MANDIR}/man1)
install(FILES ${texts}/sherf.bash DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions RENAME sherf)
install(FILES ${texts}/_sherf DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/site-functions)
install(FILES assets/body.safetensors assets/LICENSES.md DESTINATION ${CMAKE_INSTALL_DATADIR}/sherf)
install(FILES assets/models/people.safetensors assets/models/blazepose.safetensors
  DESTINATION ${CMAKE_INSTALL_DATADIR}/sherf/models)
install(FILES assets/resnet50.safetensors DESTINATION ${CMAKE_INSTALL_DATADIR}/sherf OPTIONAL) # of `make assets`
