#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <utility>

namespace splinemap {

// What frames say beside tiles, as JSON, and when each part of it changed. Thread-compatible.
class Sections {
 public:
  enum Name { kMap, kLayers, kDaemons, kPoses, kScans, kPaths, kTimes };
  static constexpr int kCount = 7;
  static constexpr std::array<const char*, kCount> kNames{"map",   "layers", "daemons", "poses",
                                                          "scans", "paths",  "times"};
  using Numbers = std::array<uint64_t, kCount>;

  void Set(Name name, std::string json) {
    if (json == json_[name]) return;
    json_[name] = std::move(json);
    numbers_[name] = ++last_number_;
  }

  const std::string& json(int name) const { return json_[name]; }
  // Grow with every change; 0: never set.
  const Numbers& numbers() const { return numbers_; }

 private:
  std::array<std::string, kCount> json_;
  Numbers numbers_{};
  uint64_t last_number_ = 0;
};

}  // namespace splinemap
