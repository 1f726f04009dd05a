#pragma once

#include <string>

namespace splinemap {

// A progress bar on stderr where that is a terminal; elsewhere it prints nothing.
class ProgressBar {
 public:
  explicit ProgressBar(std::string label);
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  // The share that is done, 0 .. 1. Draws only when the bar changes.
  void Show(double share);
  // Until the next Show(), for other lines.
  void Hide();

 private:
  std::string label_;
  bool is_terminal_;
  int shown_percent_ = -1;
};

}  // namespace splinemap
