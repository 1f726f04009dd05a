#include "services/splinemapd/replier.h"

#include "lib/query/local_map.h"

namespace splinemap {

bool Replier::IsForOther(const request_t& request) const {
  const auto nonce = static_cast<uint64_t>(request.daemon_nonce);
  return nonce != 0 && nonce != daemon_nonce;
}

reply_t Replier::HeadFor(const request_t& request) const {
  const auto map = take_snapshot();
  reply_t head{};
  head.id = request.id;
  head.name = map->layers.front().id.name;
  head.daemon_nonce = static_cast<int64_t>(daemon_nonce);
  head.incarnation = static_cast<int64_t>(map->layers.front().epoch.incarnation);
  head.revision = static_cast<int64_t>(RevisionOf(*map));
  return head;
}

void Replier::Reply(const request_t& request, absl::Span<const uint8_t> reply) const {
  send(ReplyChannel(channel_prefix, static_cast<uint64_t>(request.client)), reply);
}

}  // namespace splinemap
