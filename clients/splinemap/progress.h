#pragma once

#include <string>

namespace splinemap {

// A progress bar on stderr where that is a terminal, and nothing elsewhere.
class ProgressBar {
 public:
  explicit ProgressBar(std::string label);
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  // `share` done, 0 .. 1; draws only when it looks different.
  void Show(double share);
  // Until the next Show(), for other lines.
  void Hide();

 private:
  std::string label_;
  bool is_terminal_;
  int shown_percent_ = -1;
};

}  // namespace splinemap
