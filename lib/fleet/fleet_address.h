#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace splinemap {

// Which fleet, and as whom.
struct FleetAddress {
  // NATS servers, separated by commas: nats://HOST:PORT, or tls://HOST:PORT. More are learned from
  // the first that answers.
  std::string servers;
  std::string map = "map";  // of several on the same servers: letters, digits, `_` and `-`
  // A folder with ca.pem, own.pem and own.key, as deploy/fleet/credentials.sh makes it. Empty:
  // none.
  std::string credentials;
  std::string program;  // how the servers' monitoring calls this connection

  std::string Bucket() const { return "splinemap_" + map; }
  std::string Stream() const { return "KV_" + Bucket(); }
};

// The same fleet's copies of map files (fleet_file.h).
inline FleetAddress FilesOf(FleetAddress address) {
  address.map += "_files";
  return address;
}

// InvalidArgument for what is no address; for credentials, with the file: NotFound where it is
// missing, PermissionDenied where they have expired or are not valid yet.
absl::Status CheckFleetAddress(const FleetAddress& address);

// Of the certificate of these credentials: the name that servers know.
absl::StatusOr<std::string> NameOfCredentials(const std::string& folder);

// Of the version of a NATS server, such as 2.9.10: what of a fleet's map it may lose, in words for
// people; empty where that is nothing.
std::string WhatServerMayLose(const std::string& version);

// The version of the first server that says it.
absl::StatusOr<std::string> ServerVersion(const FleetAddress& address);

}  // namespace splinemap
