#pragma once

#include <boost/asio/io_context.hpp>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "services/viewer/access.h"
#include "services/viewer/viewer.h"

namespace splinemap {

struct ServerOptions {
  std::string address = "127.0.0.1";
  uint16_t port = 8086;
  std::string token;
  std::string certificate_path;  // of TLS, PEM; both or none
  std::string key_path;
};

// HTTP and WebSocket (RFC 6455) over TCP, with TLS where it has a certificate. What comes in is
// bounded in size, number and time.
class Server {
 public:
  static constexpr int kMaxConnections = 256;

  // Takes over a socket that listens already, where whoever started the process left one
  // (LISTEN_FDS, as systemd does). InvalidArgument for an address that is not loopback without a
  // token or without TLS, and for a certificate that cannot be read; Unavailable where the port is
  // taken. `viewer` and `io` outlive it.
  static absl::StatusOr<std::unique_ptr<Server>> Listen(boost::asio::io_context& io,
                                                        const ServerOptions& options,
                                                        Viewer& viewer);
  virtual ~Server() = default;

  // Of the page, with the token.
  virtual std::string url() const = 0;
};

}  // namespace splinemap
