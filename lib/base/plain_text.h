#pragma once

#include <string>
#include <string_view>

namespace splinemap {

// Text of a bus or a file as a person may be shown it, on one line: characters that steer a
// terminal or change the order of reading, and bytes that are no UTF-8, as \xHH. The rest is as it
// is, so what is plain stays the same.
std::string PlainText(std::string_view text);
// As that, but lines stay lines, as in errors that list something.
std::string PlainLines(std::string_view text);

// A text file without the mark of UTF-8 that editors of Windows put before its first line.
std::string_view WithoutByteOrderMark(std::string_view text);

}  // namespace splinemap
