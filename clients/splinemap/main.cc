#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <exception>
#include <memory>
#include <string>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/print.h"
#include "lib/base/did_you_mean.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/config/usage_error.h"
#include "lib/fleet/fleet_flags.h"

namespace splinemap {
namespace {

constexpr const char* kMainExamples = R"(
Examples:
  splinemap simulate office.lcmlog
  splinemap build office.lcmlog office.splinemap
  splinemap render office.splinemap office.png --px-per-knot 2
  splinemap query office.splinemap 3.0 6.5
  splinemap query --live 3.0 6.5
  splinemap --fleet nats://hub query 3.0 6.5
  splinemap merge robot-1.splinemap robot-2.splinemap --out both.splinemap

splinemap COMMAND --help explains a command. --fleet, --fleet-map and --credentials may stand before
the command. Exit status: 0 done, 1 failed, 2 usage.)";

// Help without the names of types that CLI11 adds to arguments, and without ranges.
class HelpFormatter : public CLI::Formatter {
 public:
  std::string make_option_usage(const CLI::Option* option) const override {
    const std::string name = option->get_name(/*positional=*/true);
    const bool is_several = name.find(' ') != std::string::npos;  // MAP X Y
    return is_several ? name : CLI::Formatter::make_option_usage(option);
  }
  std::string make_option_opts(const CLI::Option* option) const override {
    if (option->get_positional() || option->get_type_size() == 0) return "";
    std::string type = option->get_type_name();
    if (type.find(" in [") != std::string::npos) type.resize(type.find(':'));  // FLOAT:FLOAT in [..
    if (const size_t choice = type.find(":{"); choice != std::string::npos) {
      type.erase(0, choice + 1);
    }
    return " " + type + (option->get_required() ? " (required)" : "");
  }
};

// The flags of a fleet may stand before the command, and are its own: they go behind its others.
void MoveFleetFlags(std::vector<std::string>& arguments) {
  const auto begin = arguments.begin() + std::min<ptrdiff_t>(1, std::ssize(arguments));
  auto end = begin;
  while (end != arguments.end() && IsFleetFlag(*end)) {
    const bool has_value = end->find('=') != std::string::npos;
    end += has_value || end + 1 == arguments.end() ? 1 : 2;
  }
  std::rotate(begin, end, std::find(end, arguments.end(), "--"));
}

// CLI11 takes -0.5 for a number, but -.5 for a flag.
std::vector<std::string> ArgumentsOf(int argc, char** argv) {
  std::vector<std::string> arguments(argv, argv + argc);
  MoveFleetFlags(arguments);
  for (std::string& argument : arguments) {
    if (argument.starts_with("-.")) argument.insert(1, "0");
  }
  return arguments;
}

// What is wrong with the first argument, which is a command or a flag; nothing where all is well.
std::string ProblemOfCommand(const CLI::App& app, const std::vector<std::string>& arguments) {
  if (arguments.size() < 2 || IsFleetFlag(arguments[1])) return "give a command";
  const std::string& command = arguments[1];
  std::vector<std::string> names;
  for (const CLI::App* known : app.get_subcommands([](const CLI::App*) { return true; })) {
    names.push_back(known->get_name());
  }
  if (command.starts_with('-') || std::count(names.begin(), names.end(), command) > 0) return "";
  return fmt::format("there is no command {}{}", command, DidYouMean(command, names));
}

// "; .." where a command was given a fleet and has no use for it.
std::string HintAboutFleet(const CLI::App& app) {
  const std::vector<std::string> extras = app.remaining(/*recurse=*/true);
  if (std::none_of(extras.begin(), extras.end(), IsFleetFlag)) return "";
  return "; it does not work on a fleet, splinemap snapshot --fleet makes a map file of one";
}

int Main(int argc, char** argv) {
  CLI::App app(
      "splinemap: builds, queries, merges and draws continuous occupancy maps of LCM robots.",
      "splinemap");
  app.formatter(std::make_shared<HelpFormatter>());
  app.footer(kMainExamples);
  app.set_version_flag("--version", SPLINEMAP_VERSION);
  app.require_subcommand(1);
  Command chosen;
  AddBuild(app, chosen);
  AddInfo(app, chosen);
  AddRender(app, chosen);
  AddExport(app, chosen);
  AddQuery(app, chosen);
  AddRay(app, chosen);
  AddCheck(app, chosen);
  AddDistance(app, chosen);
  AddRaster(app, chosen);
  AddDiff(app, chosen);
  AddAlign(app, chosen);
  AddLayers(app, chosen);
  AddLayer(app, chosen);
  AddMerge(app, chosen);
  AddFlatten(app, chosen);
  AddChanges(app, chosen);
  AddFold(app, chosen);
  AddForget(app, chosen);
  AddCorrect(app, chosen);
  AddTrajectory(app, chosen);
  AddVerify(app, chosen);
  AddBackup(app, chosen);
  AddRepair(app, chosen);
  AddCrop(app, chosen);
  AddDoctor(app, chosen);
  AddWatch(app, chosen);
  AddSnapshot(app, chosen);
  AddSave(app, chosen);
  AddClear(app, chosen);
  AddKeys(app, chosen);
  AddBridge(app, chosen);
  AddSimulate(app, chosen);
  AddImportCarmen(app, chosen);
  AddImportRos(app, chosen);
  AddPrefixChannels(app, chosen);
  const std::vector<std::string> arguments = ArgumentsOf(argc, argv);
  if (const std::string problem = ProblemOfCommand(app, arguments); !problem.empty()) {
    PrintLine(stderr, "splinemap: {}; splinemap --help lists the commands", problem);
    return kUsage;
  }
  std::vector<const char*> pointers;
  for (const std::string& argument : arguments) pointers.push_back(argument.c_str());
  try {
    app.parse(argc, pointers.data());
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    PrintLine(stderr, "{}{}", UsageErrorText(app, error), HintAboutFleet(app));
    return kUsage;
  }
  RemoveTemporaryFilesAtSignals();
  try {
    const absl::StatusOr<int> status = chosen();
    if (status.ok()) return *status;
    std::fflush(stdout);  // what was printed before
    fmt::print(stderr, "splinemap: {}\n", PlainLines(ErrorText(status.status())));
    return absl::IsInvalidArgument(status.status()) ? kUsage : kFailed;
  } catch (const std::exception& exception) {  // out of memory, say
    PrintLine(stderr, "splinemap: {}", exception.what());
    return kFailed;
  }
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
