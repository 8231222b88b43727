# Embeds the pages of web/ as arrays in C files: the viewer's, whose first file is the page itself, and the study's.
set(SHERF_EMBEDDED "")
function(embed_web name header)
  set(output ${CMAKE_BINARY_DIR}/${name}s.c)
  list(TRANSFORM ARGN PREPEND ${CMAKE_SOURCE_DIR}/web/ OUTPUT_VARIABLE paths)
  add_custom_command(
    OUTPUT ${output}
    COMMAND ${CMAKE_COMMAND} -D OUTPUT=${output} -D NAME=${name} -D HEADER=${header} -D FOLDER=${CMAKE_SOURCE_DIR}/web
            "-DFILES=${ARGN}" -P ${CMAKE_SOURCE_DIR}/cmake/embed_files.cmake
    DEPENDS ${paths} ${CMAKE_SOURCE_DIR}/cmake/embed_files.cmake
    VERBATIM)
  set(SHERF_EMBEDDED ${SHERF_EMBEDDED} ${output} PARENT_SCOPE)
endfunction()
embed_web(viewer_file viewer/viewer.h index.html viewer.css live.js viewer.js)
embed_web(study_file experiment/study.h study.html study.css study.js)
