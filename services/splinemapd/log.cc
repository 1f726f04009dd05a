#include "services/splinemapd/log.h"

#include <spdlog/async.h>
#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>
#include <syslog.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <utility>

#include "absl/strings/str_split.h"
#include "lib/base/plain_text.h"

namespace splinemap {
namespace {

// sd-daemon(3): who inherits the variable and writes elsewhere is not in the journal.
bool IsInJournal() {
  const char* const stream = std::getenv("JOURNAL_STREAM");
  struct stat file {};
  return stream != nullptr && fstat(STDERR_FILENO, &file) == 0 &&
         fmt::format("{}:{}", file.st_dev, file.st_ino) == stream;
}

// The text of a line.
class PlainPayload : public spdlog::custom_flag_formatter {
 public:
  void format(const spdlog::details::log_msg& message, const std::tm&,
              spdlog::memory_buf_t& line) override {
    const std::string text = PlainText({message.payload.data(), message.payload.size()});
    line.append(text.data(), text.data() + text.size());
  }
  std::unique_ptr<custom_flag_formatter> clone() const override {
    return std::make_unique<PlainPayload>();
  }
};

// The level as syslog(3) counts it.
class SyslogLevel : public spdlog::custom_flag_formatter {
 public:
  void format(const spdlog::details::log_msg& message, const std::tm&,
              spdlog::memory_buf_t& line) override {
    constexpr std::array<int, spdlog::level::n_levels> kLevels = {
        LOG_DEBUG, LOG_DEBUG, LOG_INFO, LOG_WARNING, LOG_ERR, LOG_CRIT, LOG_DEBUG};
    line.push_back(static_cast<char>('0' + kLevels.at(message.level)));
  }
  std::unique_ptr<custom_flag_formatter> clone() const override {
    return std::make_unique<SyslogLevel>();
  }
};

}  // namespace

void StartLog() {
  constexpr size_t kMaxLines = 8192;
  spdlog::init_thread_pool(kMaxLines, 1);
  spdlog::set_default_logger(std::make_shared<spdlog::async_logger>(
      "splinemapd", std::make_shared<spdlog::sinks::stderr_color_sink_mt>(), spdlog::thread_pool(),
      spdlog::async_overflow_policy::overrun_oldest));
  auto formatter = std::make_unique<spdlog::pattern_formatter>();
  formatter->add_flag<PlainPayload>('*').add_flag<SyslogLevel>('q');
  formatter->set_pattern(IsInJournal() ? "<%q>%*" : "%Y-%m-%d %H:%M:%S %^%l%$ %*");
  spdlog::set_formatter(std::move(formatter));
}

void EndLog() { spdlog::shutdown(); }

void ReportLostLines(NoticeLog& notices, size_t& reported) {
  const size_t lost = spdlog::thread_pool()->overrun_counter();
  if (lost == reported) return;
  notices.ReportProblem(
      Problem::kLostLogLines, "",
      fmt::format("{} lines of this log were lost: nobody read them", lost - reported),
      static_cast<int64_t>(lost - reported));
  reported = lost;
}

void PrintError(const std::string& lines) {
  const std::string plain = PlainLines(lines);
  const std::string level = IsInJournal() ? fmt::format("<{}>", LOG_ERR) : "";
  for (const absl::string_view line : absl::StrSplit(plain, '\n')) {
    fmt::print(stderr, "{}{}\n", level, std::string(line));
  }
}

}  // namespace splinemap
