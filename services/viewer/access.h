#pragma once

#include <string>
#include <string_view>

#include "absl/status/status.h"

namespace splinemap {

// Who may ask. A value; thread-safe where it does not change.
struct Access {
  bool is_loopback = true;  // the server listens on a loopback address
  std::string token{};      // empty: none is asked for; only on loopback

  // What a request says of where it comes from; empty where it does not.
  struct Claims {
    std::string_view host{};
    std::string_view origin{};
    std::string_view authorization{};
    std::string_view fetch_site{};  // Sec-Fetch-Site, which browsers send
    std::string_view token{};       // in the target
  };

  // PermissionDenied for a page of another site, which a browser sends here with a name of its own
  // (DNS rebinding) or with its origin; Unauthenticated for a token that is missing or wrong.
  absl::Status Check(const Claims& claims) const;
};

}  // namespace splinemap
