#include "clients/splinemap/print.h"

#include <CLI/App.hpp>
#include <nlohmann/json.hpp>

namespace splinemap {

void AddJsonFlag(CLI::App& command, bool& json) {
  command.add_flag("--json", json, "Print JSON, for programs");
}

void PrintJson(const nlohmann::json& json, int indent) {
  fmt::print("{}\n", json.dump(indent, ' ', true, nlohmann::json::error_handler_t::replace));
}

}  // namespace splinemap
