#pragma once

#include <cstdint>
#include <string>

namespace splinemap {

// A daemon that answers.
struct DaemonIdentity {
  std::string name;  // of the robot
  uint64_t nonce = 0;
  uint64_t session_number = 0;
};

}  // namespace splinemap
