# The viewer's page, web/*, as arrays in a C file. The first file is the page itself.
set(SHERF_EMBEDDED ${CMAKE_BINARY_DIR}/web_files.c)
set(SHERF_WEB index.html viewer.css live.js viewer.js)
list(TRANSFORM SHERF_WEB PREPEND ${CMAKE_SOURCE_DIR}/web/ OUTPUT_VARIABLE SHERF_WEB_PATHS)
add_custom_command(
  OUTPUT ${SHERF_EMBEDDED}
  COMMAND ${CMAKE_COMMAND} -D OUTPUT=${SHERF_EMBEDDED} -D FOLDER=${CMAKE_SOURCE_DIR}/web "-DFILES=${SHERF_WEB}"
          -P ${CMAKE_SOURCE_DIR}/cmake/embed_files.cmake
  DEPENDS ${SHERF_WEB_PATHS} ${CMAKE_SOURCE_DIR}/cmake/embed_files.cmake
  VERBATIM)
