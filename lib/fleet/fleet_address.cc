#include "lib/fleet/fleet_address.h"

#include <netdb.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <memory>
#include <optional>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr int kTimeout_ms = 2000;

struct HostAndPort {
  std::string host;
  std::string port;
};

absl::StatusOr<HostAndPort> ParseServer(const std::string& url) {
  std::string rest = url;
  for (const std::string scheme : {"nats://", "tls://"}) {
    if (rest.rfind(scheme, 0) == 0) rest = rest.substr(scheme.size());
  }
  if (rest.find('@') != std::string::npos) {
    return InvalidArgument(
        "{}: a fleet's credentials are certificates, in a folder; no name and password", url);
  }
  if (rest.empty() || rest.find("://") != std::string::npos) {
    return InvalidArgument("{} is no NATS server: give nats://HOST:PORT or tls://HOST:PORT", url);
  }
  const size_t colon = rest.rfind(':');
  const bool has_port = colon != std::string::npos && rest.find(']', colon) == std::string::npos;
  HostAndPort server{has_port ? rest.substr(0, colon) : rest,
                     has_port ? rest.substr(colon + 1) : "4222"};
  if (server.host.size() > 2 && server.host.front() == '[' && server.host.back() == ']') {
    server.host = server.host.substr(1, server.host.size() - 2);
  }
  int port = 0;
  if (server.host.empty() || !absl::SimpleAtoi(server.port, &port) || port < 1 || port > 65535) {
    return InvalidArgument("{} is no NATS server: give nats://HOST:PORT or tls://HOST:PORT", url);
  }
  return server;
}

using Certificate = std::unique_ptr<X509, decltype(&X509_free)>;

absl::StatusOr<Certificate> ReadCertificate(const std::string& path) {
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "re"),
                                                             std::fclose);
  if (!file) {
    return NotFound(
        "{} is not there, or cannot be read: credentials are a folder with ca.pem, own.pem and "
        "own.key, as deploy/fleet/credentials.sh makes it",
        path);
  }
  Certificate certificate(PEM_read_X509(file.get(), nullptr, nullptr, nullptr), X509_free);
  if (!certificate) return InvalidArgument("{} is no certificate", path);
  return certificate;
}

std::string TextOf(const ASN1_TIME* time) {
  std::tm parts{};
  if (ASN1_TIME_to_tm(time, &parts) != 1) return "an unknown time";
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%d %H:%M UTC", &parts);
  return text.data();
}

absl::Status CheckCertificate(const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Certificate certificate, ReadCertificate(path));
  const ASN1_TIME* const end = X509_get0_notAfter(certificate.get());
  const ASN1_TIME* const begin = X509_get0_notBefore(certificate.get());
  if (X509_cmp_current_time(end) < 0) {
    return absl::PermissionDeniedError(
        fmt::format("{} has expired on {}: make new credentials with "
                    "deploy/fleet/credentials.sh, or set this computer's clock",
                    path, TextOf(end)));
  }
  if (X509_cmp_current_time(begin) > 0) {
    return absl::PermissionDeniedError(fmt::format(
        "{} is valid from {} on: is this computer's clock right?", path, TextOf(begin)));
  }
  return absl::OkStatus();
}

std::optional<std::string> ReadInfo(const HostAndPort& server) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (getaddrinfo(server.host.c_str(), server.port.c_str(), &hints, &found) != 0) return {};
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> addresses(found, freeaddrinfo);
  for (const addrinfo* address = found; address != nullptr; address = address->ai_next) {
    const int connection =
        socket(address->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (connection < 0) continue;
    std::string info;
    pollfd ready{connection, POLLOUT, 0};
    if (connect(connection, address->ai_addr, address->ai_addrlen) == 0 || errno == EINPROGRESS) {
      if (poll(&ready, 1, kTimeout_ms) == 1) {
        ready.events = POLLIN;
        std::array<char, 4096> part{};
        while (info.size() < 65536 && info.find('\n') == std::string::npos &&
               poll(&ready, 1, kTimeout_ms) == 1) {
          const ssize_t size = recv(connection, part.data(), part.size(), 0);
          if (size <= 0) break;
          info.append(part.data(), static_cast<size_t>(size));
        }
      }
    }
    close(connection);
    if (info.rfind("INFO ", 0) == 0) return info;
  }
  return std::nullopt;
}

// Whether version a is at least b: numbers with dots.
bool IsAtLeast(const std::string& version, std::array<int, 3> least) {
  std::array<int, 3> parts{};
  const std::vector<std::string> texts = absl::StrSplit(version, absl::ByAnyChar(".-"));
  for (size_t k = 0; k < parts.size() && k < texts.size(); ++k) {
    if (!absl::SimpleAtoi(texts[k], &parts[k])) break;
  }
  return parts >= least;
}

}  // namespace

absl::Status CheckFleetAddress(const FleetAddress& address) {
  for (const std::string& url : std::vector<std::string>(absl::StrSplit(address.servers, ','))) {
    SPLINEMAP_RETURN_IF_ERROR(ParseServer(url).status());
  }
  const bool is_token = std::all_of(address.map.begin(), address.map.end(), [](unsigned char c) {
    return absl::ascii_isalnum(c) || c == '_' || c == '-';
  });
  if (address.map.empty() || address.map.size() > 64 || !is_token) {
    return InvalidArgument("the name of a fleet's map has letters, digits, _ and -: not '{}'",
                           address.map);
  }
  if (address.credentials.empty()) return absl::OkStatus();
  for (const char* const file : {"ca.pem", "own.pem"}) {
    SPLINEMAP_RETURN_IF_ERROR(CheckCertificate(address.credentials + "/" + file));
  }
  const std::string key = address.credentials + "/own.key";
  if (access(key.c_str(), R_OK) != 0) {
    return NotFound("{} is not there, or this user may not read it", key);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::string> NameOfCredentials(const std::string& folder) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Certificate certificate, ReadCertificate(folder + "/own.pem"));
  std::array<char, 256> name{};
  if (X509_NAME_get_text_by_NID(X509_get_subject_name(certificate.get()), NID_commonName,
                                name.data(), name.size()) < 0) {
    return InvalidArgument("{}/own.pem has no common name", folder);
  }
  return name.data();
}

std::string WhatServerMayLose(const std::string& version) {
  if (IsAtLeast(version, {2, 12, 4}) ||
      (IsAtLeast(version, {2, 11, 12}) && !IsAtLeast(version, {2, 12, 0}))) {
    return "";
  }
  if (!IsAtLeast(version, {2, 10, 0})) {
    return fmt::format(
        "nats-server {} loses acknowledged writes at times when a server is killed, and up to a "
        "minute of them where the power of all servers fails. Robots keep their maps; "
        "deploy/fleet/newer_server.sh fetches a better one",
        version);
  }
  return fmt::format(
      "nats-server {} has faults in recovery after a power cut that 2.11.12 and 2.12.4 mend. "
      "Robots fill in what it forgets, as soon as they are in touch",
      version);
}

absl::StatusOr<std::string> ServerVersion(const FleetAddress& address) {
  for (const std::string& url : std::vector<std::string>(absl::StrSplit(address.servers, ','))) {
    SPLINEMAP_ASSIGN_OR_RETURN(const HostAndPort server, ParseServer(url));
    const std::optional<std::string> info = ReadInfo(server);
    if (!info) continue;
    const std::string field = "\"version\":\"";
    const size_t begin = info->find(field);
    if (begin == std::string::npos) continue;
    const size_t end = info->find('"', begin + field.size());
    return info->substr(begin + field.size(), end - begin - field.size());
  }
  return Unavailable("no NATS server answers at {}", address.servers);
}

}  // namespace splinemap
