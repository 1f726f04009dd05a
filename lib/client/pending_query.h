#pragma once

#include <functional>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lcmtypes/splinemap/request_t.hpp"
#include "lib/base/status.h"
#include "lib/client/request_flow.h"
#include "lib/rpc/encoded.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"

namespace splinemap {

// Requires Check(query).ok(). Who waits for the answer keeps the query meanwhile: `Held` is a
// reference to it then.
template <typename Query, typename Held = Query>
class PendingQuery : public PendingRequest {
 public:
  using Answer = typename Query::Answer;
  using Done = std::function<void(absl::StatusOr<Answer>)>;

  PendingQuery(Held query, Done done)
      : query_(std::forward<Held>(query)), chunks_(Split(query_)), done_(std::move(done)) {}

  std::string Channel(const std::string& channel_prefix) const override {
    return channel_prefix + Rpc<Query>::kChannel;
  }
  size_t num_chunks() const override { return chunks_.size(); }
  bool is_command() const override { return false; }
  bool is_waited_for() const override { return std::is_reference_v<Held>; }
  std::string Describe() const override {
    return fmt::format("query of {} {}", chunks_.back().end, Rpc<Query>::kName);
  }

  std::vector<uint8_t> Encode(size_t chunk, const request_t& header) const override {
    return EncodeRequest(query_, chunks_[chunk], header);
  }

  absl::StatusOr<reply_t> HandleReply(size_t chunk, absl::Span<const uint8_t> message) override {
    return splinemap::HandleReply(message, query_, chunks_[chunk], answer_);
  }

  void Finish(const absl::Status& status) override {
    done_(status.ok() ? absl::StatusOr<Answer>(std::move(answer_)) : status);
  }

 private:
  const Held query_;
  const std::vector<Chunk> chunks_;
  const Done done_;
  Answer answer_;
};

// `Request` is a command_request_t or layer_command_request_t, its header left out.
template <typename Request>
class PendingCommand : public PendingRequest {
 public:
  using Done = std::function<void(absl::Status)>;

  PendingCommand(Request request, Done done)
      : request_(std::move(request)), done_(std::move(done)) {}

  std::string Channel(const std::string& channel_prefix) const override {
    return channel_prefix + kCommandChannel;
  }
  size_t num_chunks() const override { return 1; }
  bool is_command() const override { return true; }
  std::string Describe() const override { return "command " + request_.command; }

  std::vector<uint8_t> Encode(size_t, const request_t& header) const override {
    Request request = request_;
    request.header = header;
    return splinemap::Encode(request);
  }

  absl::StatusOr<reply_t> HandleReply(size_t, absl::Span<const uint8_t> message) override {
    SPLINEMAP_ASSIGN_OR_RETURN(const auto reply, Decode<command_reply_t>(message));
    return reply.header;
  }

  void Finish(const absl::Status& status) override { done_(status); }

 private:
  const Request request_;
  const Done done_;
};

}  // namespace splinemap
