#pragma once

#include <cstdio>
#include <nlohmann/json.hpp>
#include <utility>

#include "fmt/format.h"
#include "lib/base/plain_text.h"

namespace splinemap {

// One line for people, on stdout or stderr. Whatever names and texts it has in it, it stays one
// line and does not steer the terminal.
template <typename... Args>
void Say(std::FILE* to, fmt::format_string<Args...> format, Args&&... args) {
  fmt::print(to, "{}\n", PlainText(fmt::format(format, std::forward<Args>(args)...)));
}

// On stdout, for programs; in ASCII, so texts may be any bytes. `indent` -1: on one line.
inline void PrintJson(const nlohmann::json& json, int indent = 2) {
  fmt::print("{}\n", json.dump(indent, ' ', true, nlohmann::json::error_handler_t::replace));
}

}  // namespace splinemap
