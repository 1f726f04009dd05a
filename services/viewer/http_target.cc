#include "services/viewer/http_target.h"

#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

std::optional<std::string> PercentDecoded(std::string_view text) {
  std::string decoded;
  for (size_t k = 0; k < text.size(); ++k) {
    if (text[k] != '%') {
      decoded += text[k] == '+' ? ' ' : text[k];
      continue;
    }
    uint32_t value = 0;
    const std::string digits(text.substr(k + 1, 2));
    if (digits.size() < 2 || !absl::SimpleHexAtoi(digits, &value) || value == 0)
      return std::nullopt;
    decoded += static_cast<char>(value);
    k += 2;
  }
  return decoded;
}

}  // namespace

absl::StatusOr<HttpTarget> HttpTarget::Parse(std::string_view target) {
  if (target.empty() || target[0] != '/' || target.size() > kMaxBytes)
    return InvalidArgument("the target of the request is no path of up to {} bytes", kMaxBytes);
  HttpTarget parsed;
  const size_t query = target.find('?');
  parsed.path = target.substr(0, query);
  if (query == std::string_view::npos) return parsed;
  const std::string pairs(target.substr(query + 1));
  const std::vector<std::string> parts = absl::StrSplit(pairs, '&', absl::SkipEmpty());
  for (const std::string& pair : parts) {
    const size_t equals = pair.find('=');
    const std::optional<std::string> name = PercentDecoded(pair.substr(0, equals));
    const std::optional<std::string> value =
        PercentDecoded(equals == std::string::npos ? "" : pair.substr(equals + 1));
    if (!name || !value) return InvalidArgument("the parameter {} is not percent-encoded", pair);
    if (!parsed.parameters.try_emplace(*name, *value).second)
      return InvalidArgument("the parameter {} is there twice", *name);
  }
  return parsed;
}

absl::StatusOr<double> HttpTarget::Number(const std::string& name) const {
  const auto parameter = parameters.find(name);
  if (parameter == parameters.end()) return InvalidArgument("the parameter {} is missing", name);
  double number = 0;
  if (!absl::SimpleAtod(parameter->second, &number) || !std::isfinite(number))
    return InvalidArgument("the parameter {} is {}, which is no number", name, parameter->second);
  return number;
}

absl::StatusOr<double> HttpTarget::NumberOr(const std::string& name, double otherwise) const {
  return parameters.contains(name) ? Number(name) : absl::StatusOr<double>(otherwise);
}

}  // namespace splinemap
