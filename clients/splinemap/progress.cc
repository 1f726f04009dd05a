#include "clients/splinemap/progress.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <utility>

namespace splinemap {

ProgressBar::ProgressBar(std::string label)
    : label_(std::move(label)), is_terminal_(isatty(STDERR_FILENO) == 1) {}

ProgressBar::~ProgressBar() { Hide(); }

void ProgressBar::Hide() {
  if (shown_percent_ >= 0) std::fputs("\r\x1b[K", stderr);
  shown_percent_ = -1;
}

void ProgressBar::Show(double share) {
  const int percent = share > 0 ? static_cast<int>(std::min(share, 1.0) * 100) : 0;  // also NaN
  if (!is_terminal_ || percent == shown_percent_) return;
  shown_percent_ = percent;
  constexpr int kWidth = 40;
  const std::string bar(percent * kWidth / 100, '#');
  std::fprintf(stderr, "\r%s [%-*s] %3d %%", label_.c_str(), kWidth, bar.c_str(), percent);
}

}  // namespace splinemap
