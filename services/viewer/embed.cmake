# cmake -DOUT=.. -DFOLDER=.. -P embed.cmake: the files of the page as C++.
set(types index.html=text/html viewer.css=text/css viewer.js=text/javascript)
set(arrays "")
set(rows "")
foreach(pair IN LISTS types)
  string(REPLACE "=" ";" pair "${pair}")
  list(GET pair 0 name)
  list(GET pair 1 type)
  file(READ ${FOLDER}/${name} bytes HEX)
  string(REGEX REPLACE "(..)" "0x\\1," bytes "${bytes}")
  string(MAKE_C_IDENTIFIER ${name} identifier)
  string(APPEND arrays "constexpr unsigned char ${identifier}[] = {${bytes}};\n")
  set(path /${name})
  if(name STREQUAL index.html)
    set(path /)
  endif()
  string(APPEND rows "    {\"${path}\", \"${type}; charset=utf-8\", "
         "{reinterpret_cast<const char*>(${identifier}), sizeof(${identifier})}},\n")
endforeach()
file(WRITE ${OUT} "#include \"services/viewer/page_file.h\"

namespace splinemap {
namespace {
${arrays}}  // namespace

absl::Span<const PageFile> PageFiles() {
  static const PageFile kFiles[] = {
${rows}  };
  return kFiles;
}

}  // namespace splinemap
")
