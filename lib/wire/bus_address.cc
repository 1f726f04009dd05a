#include "lib/wire/bus_address.h"

#include <arpa/inet.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <string_view>

#include "absl/strings/numbers.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

// What both sides of tcpq say first.
constexpr uint32_t kServerMagic = 0x287617fa;
constexpr uint32_t kClientMagic = 0x287617fb;
constexpr uint32_t kProtocolVersion = 0x0100;

constexpr timeval kServerPatience{1, 0};

class Socket {
 public:
  explicit Socket(int type) : fd_(socket(AF_INET, type | SOCK_CLOEXEC, 0)) {}
  ~Socket() {
    if (fd_ >= 0) close(fd_);
  }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;
  int fd() const { return fd_; }

 private:
  const int fd_;
};

}  // namespace

absl::StatusOr<BusAddress> BusAddress::Parse(const std::string& url) {
  BusAddress address;
  const char* const variable = std::getenv("LCM_DEFAULT_URL");
  const bool is_default = url.empty() && variable != nullptr && *variable != '\0';
  address.url_ = is_default ? variable : url.empty() ? "udpm://" : url;
  const auto wrong = [&](const std::string& why) {
    return InvalidArgument("{}{} is no LCM URL: {}", address.url_,
                           is_default ? " (LCM_DEFAULT_URL)" : "", why);
  };
  const size_t end = address.url_.find("://");
  address.scheme_ = address.url_.substr(0, end);
  const bool is_local = address.scheme_ == "memq" || address.scheme_ == "file";
  if (end == std::string::npos || (!address.is_network() && !is_local)) {
    return wrong("it begins with udpm://, tcpq://, memq:// or file://");
  }
  if (is_local) return address;
  std::string place = address.url_.substr(end + 3);
  place.resize(std::min(place.size(), place.find('?')));
  if (place.empty()) place = address.is_udpm() ? "239.255.76.67:7667" : "127.0.0.1:7700";
  const size_t colon = place.find(':');
  uint32_t port = address.is_udpm() ? 0 : 7700;
  if (colon != std::string::npos && !absl::SimpleAtoi(place.substr(colon + 1), &port)) port = 0;
  if (port < 1 || port > 65535) return wrong("the port is missing, or not in 1 .. 65535");
  address.place_.sin_family = AF_INET;
  address.place_.sin_port = htons(static_cast<uint16_t>(port));
  const std::string host = place.substr(0, colon);
  if (inet_pton(AF_INET, host.c_str(), &address.place_.sin_addr) != 1) {
    return wrong("LCM takes addresses of numbers, as 192.168.1.2, and no names");
  }
  if (address.is_udpm() && !IN_MULTICAST(ntohl(address.place_.sin_addr.s_addr))) {
    return wrong("a multicast address is in 224.0.0.0/4");
  }
  return address;
}

absl::Status BusAddress::Reach() const {
  if (is_udpm()) return ReachGroup();
  return is_tcpq() ? ReachServer() : absl::OkStatus();
}

absl::Status BusAddress::ReachGroup() const {
  const Socket socket(SOCK_DGRAM);
  if (connect(socket.fd(), reinterpret_cast<const sockaddr*>(&place_), sizeof(place_)) == 0) {
    return absl::OkStatus();
  }
  return Unavailable(
      "the LCM bus {} cannot be opened: {}; is there a multicast route? Try: sudo ip link set lo "
      "multicast on && sudo ip route add 224.0.0.0/4 dev lo",
      url_, std::strerror(errno));
}

absl::Status BusAddress::ReachServer() const {
  const Socket socket(SOCK_STREAM);
  const auto fails = [&](const char* why) {
    return Unavailable(
        "the LCM server of {} is away: {}; is it running? Try: java -cp lcm.jar lcm.lcm.TCPService "
        "{}",
        url_, why, ntohs(place_.sin_port));
  };
  setsockopt(socket.fd(), SOL_SOCKET, SO_SNDTIMEO, &kServerPatience, sizeof(kServerPatience));
  setsockopt(socket.fd(), SOL_SOCKET, SO_RCVTIMEO, &kServerPatience, sizeof(kServerPatience));
  if (connect(socket.fd(), reinterpret_cast<const sockaddr*>(&place_), sizeof(place_)) != 0) {
    return fails(errno == EINPROGRESS ? "no answer" : std::strerror(errno));
  }
  const uint32_t greeting[] = {htonl(kClientMagic), htonl(kProtocolVersion)};
  uint32_t answer[2] = {};
  if (send(socket.fd(), greeting, sizeof(greeting), MSG_NOSIGNAL) != sizeof(greeting) ||
      recv(socket.fd(), answer, sizeof(answer), MSG_WAITALL) != sizeof(answer)) {
    return fails("no answer");
  }
  if (answer[0] != htonl(kServerMagic)) return fails("what answers there is another program");
  return absl::OkStatus();
}

}  // namespace splinemap
