#pragma once

#include <netinet/in.h>

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace splinemap {

// Where an LCM bus is. liblcm 1.3.1 takes host names, bad ports and servers that do not answer for
// something else, aborts, or waits for ever; what passes here it can open. A value.
class BusAddress {
 public:
  // `url` as LCM takes it: udpm:// (multicast), tcpq:// (a server), memq:// or file://. Empty for
  // LCM_DEFAULT_URL or, without that, LCM's default. InvalidArgument for what can never be opened.
  static absl::StatusOr<BusAddress> Parse(const std::string& url);

  const std::string& url() const { return url_; }
  bool is_udpm() const { return scheme_ == "udpm"; }
  bool is_tcpq() const { return scheme_ == "tcpq"; }
  // It can go away and come back, unlike a file and what is in the memory.
  bool is_network() const { return is_udpm() || is_tcpq(); }

  // Whether the network can be opened at the moment: there is a multicast route, or the server
  // answers within a second. Unavailable says what to do about it.
  absl::Status Reach() const;

 private:
  absl::Status ReachGroup() const;
  absl::Status ReachServer() const;

  std::string url_;
  std::string scheme_;
  sockaddr_in place_{};  // of the group, or of the server
};

}  // namespace splinemap
