#pragma once

#include <cstdio>
#include <nlohmann/json_fwd.hpp>
#include <utility>

#include "fmt/format.h"
#include "lib/base/plain_text.h"

namespace CLI {
class App;
}

namespace splinemap {

// Prints one line for people, on stdout or stderr. Whatever names and texts are in it, it stays one
// line and does not steer the terminal.
template <typename... Args>
void PrintLine(std::FILE* to, fmt::format_string<Args...> format, Args&&... args) {
  fmt::print(to, "{}\n", PlainText(fmt::format(format, std::forward<Args>(args)...)));
}

// Adds --json.
void AddJsonFlag(CLI::App& command, bool& json);

// Prints to stdout, for programs; in ASCII, so texts may be any bytes. `indent` -1: on one line.
void PrintJson(const nlohmann::json& json, int indent = 2);

}  // namespace splinemap
