# cmake -D OUTPUT=FILE.c -D FOLDER=... -D FILES=a;b -P embed_files.cmake: viewer_files of src/viewer/viewer.h.
set(types_html "text/html; charset=utf-8")
set(types_css "text/css; charset=utf-8")
set(types_js "text/javascript; charset=utf-8")
set(arrays "")
set(table "")
set(n 0)
foreach(file ${FILES})
  file(READ ${FOLDER}/${file} hex HEX)
  string(LENGTH "${hex}" digits)
  math(EXPR bytes "${digits} / 2")
  string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," hex "${hex}")
  string(REGEX REPLACE "^.*\\." "" end ${file})
  string(APPEND arrays "static const unsigned char file_${n}[] = {${hex}};\n")
  string(APPEND table "    {\"${file}\", \"${types_${end}}\", file_${n}, ${bytes}},\n")
  math(EXPR n "${n} + 1")
endforeach()
file(WRITE ${OUTPUT} "/* Made by cmake/embed_files.cmake. */
#include \"viewer/viewer.h\"

${arrays}
const viewer_file viewer_files[] = {
${table}};
const int viewer_file_count = ${n};
")
