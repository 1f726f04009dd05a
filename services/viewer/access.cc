#include "services/viewer/access.h"

#include <arpa/inet.h>

#include "lib/base/status.h"

namespace splinemap {
namespace {

// "localhost:8086" without its port.
std::string_view NameOfHost(std::string_view host) {
  if (host.starts_with('[')) return host.substr(0, host.find(']') + 1);
  return host.substr(0, host.find(':'));
}

bool IsLoopbackName(std::string_view name) {
  if (name == "localhost" || name == "[::1]") return true;
  in_addr address{};
  return inet_pton(AF_INET, std::string(name).c_str(), &address) == 1 &&
         ntohl(address.s_addr) >> 24 == IN_LOOPBACKNET;
}

// Of a page that came from elsewhere, as the browser says.
bool IsOfOtherSite(const Access::Claims& claims) {
  if (claims.fetch_site == "cross-site" || claims.fetch_site == "same-site") return true;
  if (claims.origin.empty()) return false;
  const size_t host = claims.origin.find("://");
  return host == std::string_view::npos || claims.origin.substr(host + 3) != claims.host;
}

// Takes as long wherever they differ.
bool IsEqual(std::string_view a, std::string_view b) {
  unsigned char differs = a.size() == b.size() ? 0 : 1;
  for (size_t k = 0; k < a.size() && k < b.size(); ++k)
    differs |= static_cast<unsigned char>(a[k] ^ b[k]);
  return differs == 0;
}

}  // namespace

absl::Status Access::Check(const Claims& claims) const {
  if (is_loopback && !IsLoopbackName(NameOfHost(claims.host))) {
    return absl::PermissionDeniedError("ask for localhost: this server knows no other name");
  }
  if (IsOfOtherSite(claims)) return absl::PermissionDeniedError("pages of other sites may not ask");
  if (token.empty()) return absl::OkStatus();
  constexpr std::string_view kBearer = "Bearer ";
  const std::string_view told = claims.authorization.starts_with(kBearer)
                                    ? claims.authorization.substr(kBearer.size())
                                    : claims.token;
  if (IsEqual(told, token)) return absl::OkStatus();
  return absl::UnauthenticatedError(
      told.empty() ? "a token is asked for: open the page with ?token=.. as the server printed it"
                   : "the token is wrong");
}

}  // namespace splinemap
