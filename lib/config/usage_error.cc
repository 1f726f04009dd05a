#include "lib/config/usage_error.h"

#include <algorithm>
#include <vector>

#include "fmt/format.h"
#include "lib/base/did_you_mean.h"
#include "lib/base/plain_text.h"

namespace splinemap {
namespace {

// What follows a flag that is not there may be its value.
std::string ProblemOfExtras(const CLI::App& command, const std::vector<std::string>& words) {
  const auto first_flag = std::find_if(
      words.begin(), words.end(), [](const std::string& word) { return word.starts_with('-'); });
  const std::string& word = first_flag == words.end() ? words.front() : *first_flag;
  if (!word.starts_with('-')) return fmt::format("{} is one argument too many", word);
  std::vector<std::string> flags;
  for (const CLI::Option* option : command.get_options()) {
    for (const std::string& name : option->get_lnames()) flags.push_back("--" + name);
  }
  const std::string flag = word.substr(0, word.find('='));
  return fmt::format("there is no flag {}{}", flag, DidYouMean(flag, flags));
}

}  // namespace

std::string UsageErrorText(const CLI::App& app, const CLI::ParseError& error) {
  const CLI::App* command = &app;
  std::string name = app.get_name();
  while (!command->get_subcommands().empty()) {
    command = command->get_subcommands().front();
    name += " " + command->get_name();
  }
  const std::vector<std::string> extras = app.remaining(/*recurse=*/true);
  const bool has_extras =
      error.get_exit_code() == static_cast<int>(CLI::ExitCodes::ExtrasError) && !extras.empty();
  const std::string problem = has_extras ? ProblemOfExtras(*command, extras) : error.what();
  return PlainText(fmt::format("{}: {}; {} --help explains it", name, problem, name));
}

}  // namespace splinemap
