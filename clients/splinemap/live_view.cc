#include "clients/splinemap/live_view.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_replace.h"
#include "clients/splinemap/preview.h"
#include "fmt/format.h"
#include "lib/base/plain_text.h"

namespace splinemap {
namespace {

constexpr size_t kMaxDaemons = 16;
constexpr std::chrono::seconds kSilent(3);
constexpr std::chrono::seconds kForgotten(60);

std::string Staleness(double staleness_ms) {
  if (!std::isfinite(staleness_ms)) return "never caught up";
  return staleness_ms < 10'000 ? fmt::format("{:.0f} ms", staleness_ms)
                               : fmt::format("{:.0f} s", staleness_ms / 1000);
}

std::string CountsOf(const status_t& status) {
  std::string line = fmt::format(
      "{}: {} of {} scans mapped, {} poses; {} waiting; {} tiles", PlainText(status.name),
      status.scans_mapped, status.scans_received, status.poses_received,
      int64_t{status.messages_queued} + status.scans_queued, status.tiles);
  if (status.scan_time_mean_ms > 0) {
    line += fmt::format("; {:.3f} ms a scan", status.scan_time_mean_ms);
  }
  for (size_t k = 0; k < status.drop_reasons.size(); ++k) {
    line += fmt::format("{} {} {}", k == 0 ? "; dropped" : ",", status.drop_counts[k],
                        PlainText(status.drop_reasons[k]));
  }
  return line;
}

}  // namespace

std::string ScreenOf(std::string text, int wrapped, const MapView& map) {
  const auto lines = static_cast<int>(std::count(text.begin(), text.end(), '\n')) + wrapped;
  // Without a map, or with one that is too large to draw, there is no picture.
  if (const absl::StatusOr<std::string> preview = Preview(map, lines + 2); preview.ok()) {
    text += *preview;
  }
  // The rest of each line and all lines below are cleared.
  return "\x1b[H" + absl::StrReplaceAll(text, {{"\n", "\x1b[K\n"}}) + "\x1b[J";
}

std::string StatusLine(const status_t& status) {
  const std::string problem = PlainText(status.last_problem);
  return CountsOf(status) + (problem.empty() ? "" : "; " + problem);
}

void LiveView::HandleStatus(const status_t& status) {
  if (!daemons_.contains(status.daemon_nonce) && daemons_.size() >= kMaxDaemons) return;
  Daemon& daemon = daemons_[status.daemon_nonce];
  const double passed_s = status.uptime_s - daemon.status.uptime_s;
  const double scans =
      static_cast<double>(status.scans_mapped) - static_cast<double>(daemon.status.scans_mapped);
  const bool is_same_run = daemon.received != Clock::time_point() && passed_s > 0 && scans >= 0;
  daemon.scans_per_s = is_same_run ? scans / passed_s : 0;
  daemon.status = status;
  daemon.received = Clock::now();
}

std::string LiveView::Draw(Clock::time_point now) {
  const double passed_s = std::max(std::chrono::duration<double>(now - last_drawn_).count(), 1e-3);
  last_drawn_ = now;
  std::erase_if(daemons_,
                [&](const auto& daemon) { return now - daemon.second.received > kForgotten; });
  // Lines of daemons and their problems may take two rows.
  return ScreenOf(DaemonLines(now) + "\n" + LayerLines(passed_s) + "\n",
                  2 * static_cast<int>(daemons_.size()), *replica_.View());
}

std::string LiveView::DaemonLines(Clock::time_point now) const {
  std::string text;
  if (const std::string problem = replica_.BusProblem(); !problem.empty()) {
    text = PlainText(problem) + "\n";
  } else if (daemons_.empty()) {
    text = now - started_ < kSilent ? "listening ..\n"
                                    : "no status was received; is splinemapd on this bus?\n";
  }
  for (const auto& [nonce, daemon] : daemons_) {
    text += CountsOf(daemon.status) + fmt::format("; {:.1f} scans/s", daemon.scans_per_s);
    if (now - daemon.received > kSilent) {
      text += fmt::format("; no status for {:.0f} s",
                          std::chrono::duration<double>(now - daemon.received).count());
    }
    text += '\n';
    const std::string& problem = daemon.status.last_problem;
    if (!problem.empty()) text += "  " + PlainText(problem) + "\n";
  }
  return text;
}

std::string LiveView::LayerLines(double passed_s) {
  std::string text =
      fmt::format("{:<20} {:>7} {:>7} {:>9} {:>15} {:>9} {:>9}\n", "layer", "session", "tiles",
                  "commit", "staleness", "requested", "unusable");
  for (const FollowedLayer& layer : replica_.FollowedLayers()) {
    text += fmt::format("{:<20} {:>7} {:>7} {:>9} {:>15} {:>9} {:>9}  {}\n",
                        PlainText(layer.id.name), layer.session.number, layer.tiles, layer.revision,
                        Staleness(layer.staleness_ms),
                        layer.counts.asked_tiles + layer.counts.asked_scans, layer.counts.unusable,
                        layer.caught_up ? "caught up" : "behind");
  }
  for (const std::string& refused : replica_.Refused()) {
    text += fmt::format("not followed: {}\n", PlainText(refused));
  }
  const int64_t bytes = replica_.BytesReceived();
  text += fmt::format("{:.1f} kB/s received, {:.1f} MB in total\n",
                      static_cast<double>(bytes - bytes_) / passed_s / 1000,
                      static_cast<double>(bytes) / 1e6);
  bytes_ = bytes;
  return text;
}

}  // namespace splinemap
