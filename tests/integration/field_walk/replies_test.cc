// Every field of what daemons reply, to its extremes, against a client beside which there is an
// honest daemon. In a time of its own.
#include <gtest/gtest.h>

#include <functional>
#include <ostream>

#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lib/base/clock.h"
#include "lib/client/pending_query.h"
#include "lib/client/request_flow.h"
#include "lib/rpc/answer.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "splinemap/local_map.h"
#include "tests/integration/field_walk/variants.h"
#include "tests/support/queries.h"

namespace splinemap::field_walk_replies_test {

using std::chrono::milliseconds;
using std::chrono::seconds;
using Bytes = std::vector<uint8_t>;

const LocalMap& TheMap() {
  static const LocalMap kMap(RandomMap(1));
  return kMap;
}

// What a query or command of a type has come to: how often it ended, and whether rightly.
struct Outcome {
  int ends = 0;
  bool is_right = false;
};
using Start = std::function<std::unique_ptr<PendingRequest>(Outcome&)>;

template <typename Query>
Start StartOf(Query query) {
  return [query](Outcome& outcome) {
    return std::make_unique<PendingQuery<Query>>(
        query, [&outcome, query](const absl::StatusOr<typename Query::Answer>& answer) {
          ++outcome.ends;
          outcome.is_right = answer.ok() && AreSame(*answer, *TheMap().Ask(query));
        });
  };
}

template <typename Command>
Start StartOfCommand(Command command) {
  return [command](Outcome& outcome) {
    return std::make_unique<PendingCommand<Command>>(command, [&](const absl::Status& status) {
      ++outcome.ends;
      outcome.is_right = status.ok();
    });
  };
}

// A client and the daemon that it asks.
class Asking {
 public:
  Asking() { flow_.Seek(now_); }

  // The requests that wait, and what the daemon replies to them.
  std::vector<Bytes> Requests() {
    std::vector<Bytes> requests;
    for (auto& outgoing : flow_.DrainOutgoing()) requests.push_back(std::move(outgoing.bytes));
    return requests;
  }
  static Bytes Reply(const Bytes& request) {
    const auto header = RequestHeaderOf(request);
    if (!header || (header->daemon_nonce != 0 && header->daemon_nonce != kNonce)) return {};
    reply_t reply{};
    reply.id = header->id;
    reply.name = "robot";
    reply.daemon_nonce = kNonce;
    reply.session_number = 1;
    const MessageType type = *TypeOf(request);
    if (type != MessageType::kCommandRequest && type != MessageType::kLayerCommandRequest) {
      return AnswerRequest(request, TheMap(), reply);
    }
    command_reply_t done;
    done.header = reply;
    return Encode(done);
  }

  void Hear(const Bytes& reply) { flow_.HandleMessage(reply, now_); }

  // With all requests answered.
  void Run(milliseconds time) {
    for (const auto end = now_ + time; now_ < end; now_ += milliseconds(20)) {
      flow_.Tick(now_);
      for (const Bytes& request : Requests()) Hear(Reply(request));
      for (const auto& [request, status] : flow_.DrainFinished()) request->Finish(status);
    }
  }

  void Ask(const Start& start, Outcome& outcome) {
    flow_.Start(start(outcome), now_ + seconds(2), now_);
  }

 private:
  static constexpr int64_t kNonce = 1234567;

  RequestFlow flow_{"MAP", "robot", 7};
  Clock::time_point now_{std::chrono::hours(1)};
};

struct Walk {
  std::string name;
  Start start;
};

void PrintTo(const Walk& walk, std::ostream* out) { *out << walk.name; }

std::vector<Walk> Walks() {
  std::mt19937_64 random(1);
  command_request_t save;
  save.command = "save";
  return {{"Points", StartOf(PointsQuery{RandomPoints(random, 3).points_m, true})},
          {"Rays", StartOf(RandomRays(random, 3))},
          {"Sweeps", StartOf(RandomSweeps(random, 3))},
          {"Raster", StartOf(RandomRaster(random, 6))},
          {"Likelihoods", StartOf(RandomLikelihoods(random, 3))},
          {"Distances", StartOf(RandomDistances(random, 3))},
          {"Command", StartOfCommand(save)}};
}

class ReplyWalkTest : public testing::TestWithParam<Walk> {
 protected:
  // A valid reply to the search for a daemon, or to the request.
  Bytes Example(bool searches) const {
    Asking asking;
    if (searches) return Asking::Reply(asking.Requests().at(0));
    asking.Run(milliseconds(100));
    Outcome outcome;
    asking.Ask(GetParam().start, outcome);
    return Asking::Reply(asking.Requests().at(0));
  }

  // A reply comes as it is varied, then as it should be.
  std::string Try(const Variant& variant, bool searches) const {
    Asking asking;
    Outcome outcome;
    if (!searches) {
      asking.Run(milliseconds(100));
      asking.Ask(GetParam().start, outcome);
    }
    for (const Bytes& request : asking.Requests()) {
      const Bytes reply = Asking::Reply(request);
      asking.Hear(Apply(variant, Types().Parse(TypeNameOf(reply), reply)));
      asking.Hear(reply);
    }
    asking.Run(seconds(3));
    if (!searches && outcome.ends != 1) return fmt::format("it ended {} times", outcome.ends);
    Outcome next;
    asking.Ask(GetParam().start, next);
    asking.Run(seconds(3));
    if (next.ends != 1) return fmt::format("the next one ended {} times", next.ends);
    return next.is_right ? "" : "the next one has no right answer";
  }

  void WalkAll(bool searches) const {
    const Bytes example = Example(searches);
    const LcmValue parsed = Types().Parse(TypeNameOf(example), example);
    const std::vector<Variant> variants = VariantsOf(parsed);
    Tally(GetParam().name + (searches ? " search" : " replies")).Add(variants);
    for (const Variant& variant : variants) {
      const std::string wrong = Try(variant, searches);
      EXPECT_EQ(wrong, "") << variant.text;
    }
  }
};

TEST_P(ReplyWalkTest, NoFieldOfAReplyHoldsUpAQueryOrTheNextOne) { WalkAll(/*searches=*/false); }

INSTANTIATE_TEST_SUITE_P(, ReplyWalkTest, testing::ValuesIn(Walks()),
                         [](const auto& walk) { return walk.param.name; });

using SearchWalkTest = ReplyWalkTest;
TEST_P(SearchWalkTest, NoFieldOfAReplyHidesTheDaemon) { WalkAll(/*searches=*/true); }

INSTANTIATE_TEST_SUITE_P(, SearchWalkTest, testing::Values(Walks()[0]),
                         [](const auto& walk) { return walk.param.name; });

}  // namespace splinemap::field_walk_replies_test
