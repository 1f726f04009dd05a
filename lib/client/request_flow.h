#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lcmtypes/splinemap/request_t.hpp"
#include "lib/base/clock.h"
#include "lib/rpc/messages.h"
#include "splinemap/daemon_identity.h"

namespace splinemap {

// A query or command, in chunks that are one request each.
class PendingRequest {
 public:
  virtual ~PendingRequest() = default;

  virtual std::string Channel(const std::string& channel_prefix) const = 0;
  virtual size_t num_chunks() const = 0;
  // A command is not given again to a daemon that was started again.
  virtual bool is_command() const = 0;
  // Any thread may finish it, since that calls nothing of the caller's.
  virtual bool is_waited_for() const { return false; }
  virtual std::string Describe() const = 0;

  virtual std::vector<uint8_t> Encode(size_t chunk, const request_t& header) const = 0;
  // Keeps what a reply of status 0 says; its header. InvalidArgument for what is no reply to that
  // chunk. A reply that comes later counts.
  virtual absl::StatusOr<reply_t> HandleReply(size_t chunk, absl::Span<const uint8_t> message) = 0;
  // Once; where `status` is OK, all replies have come, of one revision.
  virtual void Finish(const absl::Status& status) = 0;
};

// How a client gets its requests through to a daemon that it finds itself, over a bus that loses,
// doubles and delays messages: what to send when, and what became of it. Without threads and
// sockets of its own. Thread-compatible.
class RequestFlow {
 public:
  static constexpr size_t kMaxUnderWay = 8;       // requests that wait for a reply
  static constexpr size_t kMaxRequests = 10'000;  // pending

  // Of robot `robot`; empty: of the first that answers, and then of that. `client` are random bits.
  RequestFlow(std::string channel_prefix, std::string robot, uint64_t client);

  std::string ReplyChannel() const { return splinemap::ReplyChannel(channel_prefix_, client_); }

  // Looks for the daemon; until it is found, requests wait.
  void Seek(Clock::time_point now);
  const std::optional<DaemonIdentity>& daemon() const { return daemon_; }
  // Of several daemons that answered when any was looked for: robots whose map is in another
  // revision than that of daemon().
  std::vector<std::string> RobotsOfOtherMaps() const;
  // What to say when none was found.
  std::string WhyNoDaemon() const;

  // The number of the request, for Remove(). Requires fewer than kMaxRequests pending.
  int64_t Start(std::unique_ptr<PendingRequest> request, Clock::time_point deadline,
                Clock::time_point now);
  // Ends a request; it is the caller's, who finishes it. Null where it is not pending.
  std::unique_ptr<PendingRequest> Remove(int64_t number);
  // All of them are to be finished with Cancelled.
  void CancelAll();
  size_t num_pending() const { return requests_.size(); }

  // Any bytes from ReplyChannel().
  void HandleMessage(absl::Span<const uint8_t> message, Clock::time_point now);
  // A reply that is not believed, and why: said where a request fails, a refusal before others.
  void HandleDisbelieved(std::string why, bool is_refusal) {
    if (is_refusal || disbelieved_.empty()) disbelieved_ = std::move(why);
  }
  // Sends again, and ends what is over its deadline. Call it often.
  void Tick(Clock::time_point now);

  struct Outgoing {
    std::string channel;
    std::vector<uint8_t> bytes;
  };
  struct Finished {
    std::unique_ptr<PendingRequest> request;
    absl::Status status;
  };
  // What the calls so far have made to be sent, and to be finished by the caller.
  std::vector<Outgoing> DrainOutgoing() { return std::exchange(outgoing_, {}); }
  std::vector<Finished> DrainFinished() { return std::exchange(finished_, {}); }

 private:
  // When to send next what gets no reply.
  struct Retry {
    Clock::time_point next;
    Clock::duration pause{};
    int sent = 0;
  };
  struct Request {
    std::unique_ptr<PendingRequest> pending;
    Clock::time_point deadline;
    int64_t query = 0;      // in the heads of its chunks
    size_t next_chunk = 0;  // the first that was not sent
    size_t answered = 0;
    std::optional<int64_t> revision;  // of the replies so far
    bool has_turn = false;            // is in turns_
    std::string problem;              // the newest that a daemon told
  };
  struct Sent {
    int64_t request = 0;
    size_t chunk = 0;
    Retry retry;
  };
  struct Search {
    int64_t id = 0;
    Retry retry;
  };

  static bool IsDue(Retry& retry, Clock::time_point now);
  void HandleSearchReply(absl::Span<const uint8_t> message);
  void HandleLaterSearchReply(absl::Span<const uint8_t> message);
  void Begin(int64_t number, Request& request);
  void BeginAllAnew();
  void Pump(Clock::time_point now);
  void Send(int64_t id, const Sent& sent);
  void Finish(int64_t number, absl::Status status);
  absl::Status Late(const Request& request) const;
  std::string WhatIsDisbelieved() const;

  const std::string channel_prefix_;
  std::string robot_;
  const uint64_t client_;
  int64_t last_number_ = 0;  // of requests, queries and ids
  std::optional<DaemonIdentity> daemon_;
  std::optional<Search> search_;
  std::vector<std::string> heard_;  // other robots, while searching
  // Of the last search for any robot: whose replies came, and the revisions of their maps.
  std::optional<int64_t> search_for_any_;
  std::map<std::string, int64_t> found_;
  std::map<int64_t, Request> requests_;
  std::deque<int64_t> turns_;     // requests that have chunks to send
  std::map<int64_t, Sent> sent_;  // by id: chunks without a reply so far
  std::string disbelieved_;       // why a reply was not believed; empty where all were
  std::vector<Outgoing> outgoing_;
  std::vector<Finished> finished_;
};

}  // namespace splinemap
