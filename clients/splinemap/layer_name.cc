#include "clients/splinemap/layer_name.h"

#include "absl/strings/ascii.h"
#include "lib/base/did_you_mean.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

bool IsNamedBy(const LayerId& id, const std::string& text) {
  if (text == id.name) return true;
  const std::string whole = fmt::format("{}@{:016x}", id.name, id.origin);
  return text.size() > id.name.size() + 1 && text.starts_with(id.name + '@') &&
         whole.starts_with(id.name + '@' + absl::AsciiStrToLower(text.substr(id.name.size() + 1)));
}

}  // namespace

std::string NameOf(const LayerId& id) {
  return fmt::format("{}@{:016x}", PlainText(id.name), id.origin);
}

absl::StatusOr<LayerId> FindLayer(const std::vector<LayerId>& layers, const std::string& text,
                                  const std::string& where) {
  std::vector<LayerId> found;
  std::vector<std::string> names;
  std::vector<std::string> candidates;
  for (const LayerId& id : layers) {
    names.push_back(id.name);
    candidates.push_back(NameOf(id));
    if (IsNamedBy(id, text)) found.push_back(id);
  }
  if (found.size() == 1) return found.front();
  if (found.empty()) {
    return InvalidArgument("{} has no layer {}{}; the layers are: {}", where, text,
                           DidYouMean(text, names), fmt::join(candidates, ", "));
  }
  candidates.clear();
  for (const LayerId& id : found) candidates.push_back(NameOf(id));
  return InvalidArgument("{} has several layers {}; give one of: {}", where, text,
                         fmt::join(candidates, ", "));
}

}  // namespace splinemap
