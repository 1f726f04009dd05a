#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>

#include <cstdio>
#include <cstdlib>

#include "absl/status/statusor.h"
#include "lib/base/status.h"

namespace splinemap {

// The multicast group of LCM_DEFAULT_URL.
inline absl::StatusOr<sockaddr_in> BusGroup() {
  const char* const url = std::getenv("LCM_DEFAULT_URL");
  char address[16] = "";
  unsigned short port = 0;
  if (url == nullptr || std::sscanf(url, "udpm://%15[0-9.]:%hu", address, &port) != 2) {
    return InvalidArgument("LCM_DEFAULT_URL is not udpm://ADDRESS:PORT; use deploy/own_bus.sh");
  }
  sockaddr_in group{};
  group.sin_family = AF_INET;
  group.sin_port = htons(port);
  group.sin_addr.s_addr = inet_addr(address);
  return group;
}

}  // namespace splinemap
