#include "lib/client/request_flow.h"

#include <gtest/gtest.h>

#include <functional>
#include <set>

#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/points_reply_t.hpp"
#include "lcmtypes/splinemap/rays_reply_t.hpp"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lib/base/clock.h"
#include "lib/client/pending_query.h"
#include "lib/rpc/answer.h"
#include "lib/wire/decode.h"
#include "splinemap/local_map.h"
#include "tests/support/queries.h"

namespace splinemap::request_flow_test {

using std::chrono::milliseconds;
using Message = std::vector<uint8_t>;

// Answers at once, from the newest map: it pins nothing.
struct FakeDaemon {
  std::string name = "robot";
  uint64_t nonce = 1;
  uint64_t session_number = 1;
  std::shared_ptr<const MapView> map = RandomMap(1);
  absl::Status refuses;
  int64_t requests = 0;
  std::set<int64_t> queries;

  // Empty where the request is for another.
  Message Answer(const Message& request) {
    const auto header = RequestHeaderOf(request);
    if (!header ||
        (header->daemon_nonce != 0 && static_cast<uint64_t>(header->daemon_nonce) != nonce)) {
      return {};
    }
    ++requests;
    queries.insert(header->query);
    reply_t reply{};
    reply.id = header->id;
    reply.name = name;
    reply.daemon_nonce = static_cast<int64_t>(nonce);
    reply.session_number = static_cast<int64_t>(session_number);
    if (!refuses.ok()) return RefuseRequest(request, refuses, reply);
    return AnswerRequest(request, LocalMap(map), reply);
  }
};

// A client and some daemons on a bus that may lose messages, in a time of their own.
class RequestFlowTest : public testing::Test {
 protected:
  template <typename Query>
  int64_t Ask(Query query, milliseconds deadline = milliseconds(2000)) {
    return flow_->Start(std::make_unique<PendingQuery<Query>>(
                            std::move(query),
                            [this](absl::StatusOr<typename Query::Answer> answer) {
                              statuses_.push_back(answer.status());
                              if constexpr (std::is_same_v<Query, PointsQuery>) {
                                if (answer.ok()) answer_ = *std::move(answer);
                              }
                            }),
                        now_ + deadline, now_);
  }

  void Exchange() {
    std::vector<RequestFlow::Outgoing> outgoing;
    while (!(outgoing = flow_->DrainOutgoing()).empty()) {
      for (const auto& [channel, request] : outgoing) {
        ++sent_;
        if (Lost()) continue;
        for (FakeDaemon& daemon : daemons_) {
          const Message reply = daemon.Answer(request);
          if (reply.empty() || Lost()) continue;
          for (int copies = 0; copies < copies_; ++copies) flow_->HandleMessage(reply, now_);
        }
      }
    }
    for (const auto& [request, status] : flow_->DrainFinished()) request->Finish(status);
  }

  void Run(milliseconds time) {
    Exchange();
    for (const auto end = now_ + time; now_ < end;) {
      now_ += milliseconds(10);
      flow_->Tick(now_);
      Exchange();
    }
  }

  void Find() {
    flow_->Seek(now_);
    Run(milliseconds(20));
    ASSERT_TRUE(flow_->daemon().has_value());
  }

  bool Lost() { return std::bernoulli_distribution(loss_)(random_); }

  std::unique_ptr<RequestFlow> flow_ = std::make_unique<RequestFlow>("MAP", "", 7);
  std::vector<FakeDaemon> daemons_{1};
  Clock::time_point now_{std::chrono::hours(1)};
  double loss_ = 0;
  int copies_ = 1;
  int64_t sent_ = 0;
  std::mt19937_64 random_{1};
  std::vector<absl::Status> statuses_;
  std::optional<PointsQuery::Answer> answer_;
};

TEST_F(RequestFlowTest, FindsTheDaemonThatAnswersAndAsksIt) {
  Find();
  EXPECT_EQ(flow_->daemon()->name, "robot");
  EXPECT_EQ(flow_->daemon()->nonce, 1u);
  const PointsQuery query = RandomPoints(random_, 9);
  Ask(query);
  Exchange();
  ASSERT_EQ(statuses_.size(), 1u);
  ASSERT_TRUE(answer_.has_value()) << statuses_[0];
  EXPECT_TRUE(AreSame(*answer_, *LocalMap(daemons_[0].map).Ask(query)));
  EXPECT_EQ(sent_, 2);
  Run(milliseconds(3000));
  EXPECT_EQ(sent_, 2) << "nothing goes on";
}

TEST_F(RequestFlowTest, TheWantedRobotIsFoundAmongOthers) {
  daemons_.resize(3);
  daemons_[1].name = "other";
  daemons_[1].nonce = 2;
  daemons_[2].name = "third";
  daemons_[2].nonce = 3;
  flow_ = std::make_unique<RequestFlow>("MAP", "other", 7);
  Find();
  EXPECT_EQ(flow_->daemon()->nonce, 2u);
  Ask(PointsQuery{});
  Exchange();
  EXPECT_EQ(daemons_[0].requests, 1) << "but for the search";
}

TEST_F(RequestFlowTest, RobotsWithAnotherMapAreNamedWhereNoneWasChosen) {
  daemons_.resize(3);
  daemons_[1].name = "follower";
  daemons_[1].nonce = 2;
  daemons_[2].name = "other";
  daemons_[2].nonce = 3;
  auto other = std::make_shared<MapView>(*daemons_[2].map);
  ++other->revision;
  daemons_[2].map = other;
  Find();
  EXPECT_EQ(flow_->RobotsOfOtherMaps(), std::vector<std::string>{"other"});
  flow_ = std::make_unique<RequestFlow>("MAP", "robot", 7);
  Find();
  EXPECT_TRUE(flow_->RobotsOfOtherMaps().empty());
}

TEST_F(RequestFlowTest, WhoIsMissingIsSaid) {
  flow_ = std::make_unique<RequestFlow>("MAP", "nobody", 7);
  flow_->Seek(now_);
  Ask(RandomPoints(random_, 9));
  Run(milliseconds(2100));
  ASSERT_EQ(statuses_.size(), 1u);
  EXPECT_TRUE(absl::IsDeadlineExceeded(statuses_[0]));
  const std::string text(statuses_[0].message());
  EXPECT_NE(text.find("nobody"), std::string::npos) << text;
  EXPECT_NE(text.find("not only that of robot"), std::string::npos) << text;
  EXPECT_NE(text.find("channel_prefix MAP"), std::string::npos) << text;
}

TEST_F(RequestFlowTest, LostAndDoubledMessagesChangeNoAnswer) {
  loss_ = 0.3;
  copies_ = 2;
  flow_->Seek(now_);
  Run(milliseconds(2000));
  ASSERT_TRUE(flow_->daemon().has_value());
  for (int n = 0; n < 20; ++n) {
    const PointsQuery query = RandomPoints(random_, 20'001);
    answer_.reset();
    Ask(query, milliseconds(30'000));
    Run(milliseconds(30'000));
    ASSERT_TRUE(answer_.has_value()) << statuses_.back();
    EXPECT_TRUE(AreSame(*answer_, *LocalMap(daemons_[0].map).Ask(query)));
  }
  EXPECT_EQ(statuses_.size(), 20u) << "each ends once";
}

TEST_F(RequestFlowTest, AFewRequestsAreUnderWayAtOnce) {
  Find();
  loss_ = 1;
  sent_ = 0;
  Ask(RandomPoints(random_, 100'000));
  Ask(RandomPoints(random_, 100'000));
  Exchange();
  EXPECT_EQ(sent_, int64_t{RequestFlow::kMaxUnderWay});
}

TEST_F(RequestFlowTest, AShortQueryDoesNotWaitForALongOne) {
  Find();
  std::vector<int64_t> finished;
  Ask(RandomPoints(random_, 200'000));
  Ask(RaysQuery{});
  // The first eight pieces of the long one are out, and the short one is next.
  auto outgoing = flow_->DrainOutgoing();
  ASSERT_EQ(outgoing.size(), RequestFlow::kMaxUnderWay);
  flow_->HandleMessage(daemons_[0].Answer(outgoing[0].bytes), now_);
  flow_->HandleMessage(daemons_[0].Answer(outgoing[1].bytes), now_);
  std::set<std::string> channels;
  for (const auto& message : flow_->DrainOutgoing()) channels.insert(message.channel);
  EXPECT_TRUE(channels.contains("MAP_RAYS_REQUESTS"));
}

TEST_F(RequestFlowTest, AnAnswerIsOfOneRevision) {
  Find();
  const PointsQuery query = RandomPoints(random_, 5000);
  Ask(query);
  auto outgoing = flow_->DrainOutgoing();
  ASSERT_EQ(outgoing.size(), 3u);
  flow_->HandleMessage(daemons_[0].Answer(outgoing[0].bytes), now_);
  // A commit, and a daemon that has forgotten what it answered from.
  auto map = std::make_shared<MapView>(*RandomMap(2));
  map->revision += 1;
  daemons_[0].map = map;
  flow_->HandleMessage(daemons_[0].Answer(outgoing[1].bytes), now_);
  flow_->HandleMessage(daemons_[0].Answer(outgoing[2].bytes), now_);
  Exchange();
  ASSERT_TRUE(answer_.has_value());
  EXPECT_TRUE(AreSame(*answer_, *LocalMap(map).Ask(query)));
  EXPECT_EQ(daemons_[0].queries.size(), 3u) << "the search, and two attempts of other numbers";
}

TEST_F(RequestFlowTest, ADaemonThatWasStartedAgainIsFound) {
  Find();
  Ask(RandomPoints(random_, 5000), milliseconds(5000));
  auto outgoing = flow_->DrainOutgoing();
  flow_->HandleMessage(daemons_[0].Answer(outgoing[0].bytes), now_);
  daemons_[0].nonce = 99;
  daemons_[0].session_number = 2;
  Run(milliseconds(1000));
  ASSERT_TRUE(answer_.has_value());
  EXPECT_EQ(flow_->daemon()->nonce, 99u);
  EXPECT_EQ(flow_->daemon()->session_number, 2u);
}

TEST_F(RequestFlowTest, AnotherRobotDoesNotTakeThePlaceOfOneThatIsGone) {
  Find();
  daemons_[0].name = "other";
  daemons_[0].nonce = 99;
  Ask(PointsQuery{});
  Run(milliseconds(2100));
  ASSERT_EQ(statuses_.size(), 1u);
  EXPECT_TRUE(absl::IsDeadlineExceeded(statuses_[0])) << statuses_[0];
  EXPECT_NE(std::string(statuses_[0].message()).find("answered 0 of 1"), std::string::npos);
  EXPECT_EQ(flow_->daemon()->nonce, 1u);
}

TEST_F(RequestFlowTest, ACommandIsNotGivenToTheNextStart) {
  Find();
  absl::Status status;
  int64_t done = 0;
  command_request_t clear;
  clear.command = "clear";
  clear.session_number = 1;
  flow_->Start(std::make_unique<PendingCommand<command_request_t>>(clear,
                                                                   [&](const absl::Status& s) {
                                                                     ++done;
                                                                     status = s;
                                                                   }),
               now_ + milliseconds(5000), now_);
  flow_->DrainOutgoing();  // lost
  daemons_[0].nonce = 99;
  Run(milliseconds(1000));
  EXPECT_EQ(done, 1);
  EXPECT_TRUE(absl::IsUnavailable(status)) << status;
}

TEST_F(RequestFlowTest, CancelledOnceAndThenGone) {
  Find();
  const int64_t number = Ask(RandomPoints(random_, 5000));
  auto outgoing = flow_->DrainOutgoing();
  const auto removed = flow_->Remove(number);
  ASSERT_NE(removed, nullptr);
  EXPECT_EQ(flow_->Remove(number), nullptr);
  removed->Finish(absl::CancelledError(""));
  Exchange();
  ASSERT_EQ(statuses_.size(), 1u);
  EXPECT_TRUE(absl::IsCancelled(statuses_[0]));
  // Its replies come late.
  for (const auto& message : outgoing) {
    flow_->HandleMessage(daemons_[0].Answer(message.bytes), now_);
  }
  Run(milliseconds(3000));
  EXPECT_EQ(statuses_.size(), 1u);
  EXPECT_EQ(flow_->num_pending(), 0u);
}

TEST_F(RequestFlowTest, AnOverloadedDaemonIsAskedAgainAndOtherErrorsEndTheQuery) {
  Find();
  daemons_[0].refuses = absl::ResourceExhaustedError("many requests wait");
  Ask(PointsQuery{});
  Run(milliseconds(300));
  EXPECT_TRUE(statuses_.empty());
  daemons_[0].refuses = absl::OkStatus();
  Run(milliseconds(1000));
  ASSERT_EQ(statuses_.size(), 1u);
  EXPECT_TRUE(statuses_[0].ok());

  daemons_[0].refuses = absl::ResourceExhaustedError("many requests wait");
  Ask(PointsQuery{});
  Run(milliseconds(2100));
  ASSERT_EQ(statuses_.size(), 2u);
  EXPECT_TRUE(absl::IsDeadlineExceeded(statuses_[1]));
  EXPECT_NE(std::string(statuses_[1].message()).find("many requests wait"), std::string::npos);

  daemons_[0].refuses = absl::UnimplementedError("not here");
  Ask(PointsQuery{});
  Run(milliseconds(20));
  ASSERT_EQ(statuses_.size(), 3u);
  EXPECT_EQ(statuses_[2], absl::UnimplementedError("not here"));
}

TEST_F(RequestFlowTest, ForgedRepliesAreNotTaken) {
  Find();
  Ask(PointsQuery{{{1, 2}}, false});
  const Message request = flow_->DrainOutgoing().at(0).bytes;
  FakeDaemon forger;
  forger.nonce = 1;
  const Message reply = forger.Answer(request);
  for (size_t size = 0; size < reply.size(); ++size) {
    flow_->HandleMessage({reply.data(), size}, now_);
  }
  auto other = *Decode<points_reply_t>(reply);
  other.header.daemon_nonce = 2;
  flow_->HandleMessage(Encode(other), now_);
  rays_reply_t rays{};
  rays.header = Decode<points_reply_t>(reply)->header;
  flow_->HandleMessage(Encode(rays), now_);
  Exchange();
  EXPECT_TRUE(statuses_.empty());
  flow_->HandleMessage(reply, now_);
  Exchange();
  EXPECT_EQ(statuses_.size(), 1u);
}

}  // namespace splinemap::request_flow_test
