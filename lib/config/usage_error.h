#pragma once

#include <CLI/App.hpp>
#include <string>

namespace splinemap {

// What is wrong with a command line, with the command and where its help is: "splinemap query:
// there is no flag --hesian (did you mean --hessian?); splinemap query --help explains it".
std::string UsageErrorText(const CLI::App& app, const CLI::ParseError& error);

}  // namespace splinemap
