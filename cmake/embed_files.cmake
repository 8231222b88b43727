# cmake -D OUTPUT=FILE.c -D NAME=viewer_file -D HEADER=viewer/viewer.h -D FOLDER=... -D FILES=a;b -P embed_files.cmake:
# writes viewer_files and viewer_file_count, as the header declares them.
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
#include \"${HEADER}\"

${arrays}
const ${NAME} ${NAME}s[] = {
${table}};
const int ${NAME}_count = ${n};
")
