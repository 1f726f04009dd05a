#include "services/splinemapd/query_server.h"

#include <gtest/gtest.h>

#include <future>

#include "lib/wire/encode.h"
#include "services/splinemapd/command_server.h"
#include "tests/support/queries.h"

namespace splinemap::query_server_test {

using std::chrono::milliseconds;

// The servers without a bus.
class QueryServerTest : public testing::Test {
 protected:
  Replier MakeReplier() {
    return {.channel_prefix = "MAP",
            .daemon_nonce = 5,
            .take_snapshot =
                [this] {
                  MutexLock lock(mutex_);
                  return map_;
                },
            .send =
                [this](const std::string& channel, absl::Span<const uint8_t> bytes) {
                  std::shared_future<void> gate;
                  {
                    MutexLock lock(mutex_);
                    gate = gate_;
                  }
                  if (gate.valid()) gate.wait();
                  MutexLock lock(mutex_);
                  replies_.push_back({channel, {bytes.begin(), bytes.end()}});
                  replied_.notify_all();
                }};
  }

  static points_request_t Request(int64_t client, int64_t id, int64_t query = 0,
                                  int64_t nonce = 5) {
    std::mt19937_64 random(1);
    points_request_t request = ToMessage(RandomPoints(random, 100), {0, 100});
    request.head.client = client;
    request.head.id = id;
    request.head.query = query;
    request.head.daemon_nonce = nonce;
    return request;
  }

  struct Reply {
    std::string channel;
    std::vector<uint8_t> bytes;
  };
  // So many, in the order in which they were sent; or fewer after ten seconds.
  std::vector<Reply> Await(size_t count) {
    std::unique_lock lock(mutex_);
    EXPECT_TRUE(
        replied_.wait_for(lock, std::chrono::seconds(10), [&] { return replies_.size() >= count; }))
        << replies_.size() << " of " << count;
    return replies_;
  }
  static reply_t Head(const Reply& reply) {
    const auto decoded = DecodeRpc<points_reply_t>(reply.bytes);
    EXPECT_TRUE(decoded.ok()) << decoded.status();
    return decoded.ok() ? decoded->head : reply_t{};
  }

  void SetMap(uint64_t seed, uint64_t revision) {
    auto map = std::make_shared<MapSnapshot>(*RandomMap(seed));
    map->layers[0].revision = revision;
    MutexLock lock(mutex_);
    map_ = map;
  }
  // Replies wait until Open().
  void Shut() {
    MutexLock lock(mutex_);
    gate_ = opens_.get_future().share();
  }
  void Open() { opens_.set_value(); }

  Mutex mutex_;
  ConditionVariable replied_;
  std::vector<Reply> replies_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<const MapSnapshot> map_ ABSL_GUARDED_BY(mutex_) = RandomMap(1);
  std::shared_future<void> gate_ ABSL_GUARDED_BY(mutex_);
  std::promise<void> opens_;
};

TEST_F(QueryServerTest, RepliesToWhoAskedWithWhoAnswers) {
  QueryServer server(MakeReplier());
  server.TakeRequest(Encode(Request(0xabc, 17)));
  const Reply reply = Await(1).at(0);
  EXPECT_EQ(reply.channel, "MAP_REPLIES_0000000000000abc");
  const auto decoded = DecodeRpc<points_reply_t>(reply.bytes);
  ASSERT_TRUE(decoded.ok());
  EXPECT_EQ(decoded->head.id, 17);
  EXPECT_EQ(decoded->head.name, "robot");
  EXPECT_EQ(decoded->head.daemon_nonce, 5);
  EXPECT_EQ(decoded->head.incarnation, 1);
  EXPECT_EQ(decoded->head.revision, 20);
  const points_request_t request = Request(0xabc, 17);
  for (size_t k = 0; k < 100; ++k) {
    EXPECT_EQ(decoded->log_odds.at(k),
              RandomMap(1)->Evaluate(request.x_m[k], request.y_m[k]).log_odds);
  }
}

TEST_F(QueryServerTest, AnotherNonceIsIgnoredAndNoneMeansAnybody) {
  QueryServer server(MakeReplier());
  server.TakeRequest(Encode(Request(1, 1, 0, 6)));
  server.TakeRequest(Encode(Request(1, 2, 0, 0)));
  EXPECT_EQ(Head(Await(1).at(0)).id, 2);
  EXPECT_EQ(server.counts().for_others, 1);
  EXPECT_EQ(server.counts().taken, 1);
}

TEST_F(QueryServerTest, RequestsOfOneQueryAreAnsweredFromOneState) {
  QueryServer server(MakeReplier());
  server.TakeRequest(Encode(Request(1, 1, 9)));
  Await(1);
  SetMap(2, 21);
  server.TakeRequest(Encode(Request(1, 2, 9)));  // the same query
  Await(2);
  server.TakeRequest(Encode(Request(2, 3, 9)));  // of another client
  Await(3);
  server.TakeRequest(Encode(Request(1, 4, 10)));  // another query
  Await(4);
  server.TakeRequest(Encode(Request(1, 5)));  // one that is alone
  Await(5);
  server.TakeRequest(Encode(Request(1, 6, 9)));  // the first query, after the newest went on
  const std::vector<Reply> replies = Await(6);
  EXPECT_EQ(replies[1].bytes.size(), replies[0].bytes.size());
  EXPECT_EQ(Head(replies[1]).revision, 20);
  EXPECT_EQ(DecodeRpc<points_reply_t>(replies[1].bytes)->log_odds,
            DecodeRpc<points_reply_t>(replies[0].bytes)->log_odds);
  EXPECT_EQ(Head(replies[2]).revision, 21);
  EXPECT_EQ(Head(replies[3]).revision, 21);
  EXPECT_EQ(Head(replies[4]).revision, 21);
  EXPECT_EQ(Head(replies[5]).revision, 20);
  EXPECT_EQ(DecodeRpc<points_reply_t>(replies[5].bytes)->log_odds,
            DecodeRpc<points_reply_t>(replies[0].bytes)->log_odds);
  EXPECT_NE(DecodeRpc<points_reply_t>(replies[4].bytes)->log_odds,
            DecodeRpc<points_reply_t>(replies[0].bytes)->log_odds);
}

TEST_F(QueryServerTest, OneClientThatAsksMuchDoesNotStarveAnother) {
  QueryServer server(MakeReplier());
  Shut();
  for (int64_t id = 0; id < 5000; ++id) server.TakeRequest(Encode(Request(1, id)));
  server.TakeRequest(Encode(Request(2, 1)));
  Open();
  const std::vector<Reply> replies = Await(6);
  const auto second = std::find_if(replies.begin(), replies.begin() + 6, [](const Reply& reply) {
    return reply.channel == "MAP_REPLIES_0000000000000002";
  });
  ASSERT_NE(second, replies.begin() + 6) << "in its turn";
  EXPECT_EQ(Head(*second).status, 0);
  EXPECT_GE(server.counts().refused, 5000 - 65);
  // As many refusals as wait, and no more.
  const std::vector<Reply> all = Await(65 + 16);
  std::this_thread::sleep_for(milliseconds(50));
  int64_t refused = 0;
  for (const Reply& reply : Await(all.size())) {
    refused += absl::IsResourceExhausted(StatusOf(Head(reply))) ? 1 : 0;
  }
  EXPECT_GE(refused, 16);
  EXPECT_LE(refused, 17);
}

TEST_F(QueryServerTest, AFloodOfNewIdsDoesNotTakeTheStateOfAQueryAway) {
  QueryServer server(MakeReplier());
  server.TakeRequest(Encode(Request(1, 1, 9)));
  server.TakeRequest(Encode(Request(1, 2, 9)));
  size_t asked = 2;
  Await(asked);
  SetMap(2, 21);
  for (int64_t stranger = 100; stranger < 200; ++stranger) {
    server.TakeRequest(Encode(Request(stranger, 1, 9)));
    Await(++asked);
  }
  server.TakeRequest(Encode(Request(1, 3, 9)));
  EXPECT_EQ(Head(Await(++asked).back()).revision, 20);
}

TEST_F(QueryServerTest, LargeAndDamagedMessagesDoNoHarm) {
  QueryServer server(MakeReplier());
  points_request_t large = Request(1, 1);
  large.num_points = 5000;
  large.x_m.resize(5000);
  large.y_m.resize(5000);
  server.TakeRequest(Encode(large));
  EXPECT_TRUE(absl::IsInvalidArgument(StatusOf(Head(Await(1).at(0)))));
  const std::vector<uint8_t> whole = Encode(Request(1, 2));
  for (size_t size = 0; size < whole.size(); ++size) server.TakeRequest({whole.data(), size});
  std::vector<uint8_t> forged = whole;
  forged[8 + 32 + 1] = 0x7f;  // the count
  server.TakeRequest(forged);
  server.TakeRequest(Encode(command_request_t{}));
  server.TakeRequest(Encode(Request(1, 3)));
  const std::vector<Reply> replies = Await(2);
  EXPECT_EQ(Head(replies.at(1)).id, 3);
  EXPECT_GT(server.counts().malformed, 40);
}

class CommandServerTest : public QueryServerTest {
 protected:
  void Start(bool allowed = true) {
    server_ = std::make_unique<CommandServer>(
        MakeReplier(), allowed, [this](const CommandServer::Request& request) {
          const auto& command = std::get<command_request_t>(request);
          MutexLock lock(mutex_);
          done_.push_back(command.command);
          return command.incarnation == 1 ? absl::OkStatus()
                                          : absl::FailedPreconditionError("start 1");
        });
  }
  void Command(int64_t client, int64_t id, const std::string& command, int64_t nonce = 5,
               int64_t incarnation = 1) {
    command_request_t request;
    request.head.client = client;
    request.head.id = id;
    request.head.query = 0;
    request.head.daemon_nonce = nonce;
    request.command = command;
    request.incarnation = incarnation;
    server_->TakeRequest(Encode(request));
  }
  absl::Status StatusOfReply(size_t number) {
    const auto reply = DecodeRpc<command_reply_t>(Await(number + 1).at(number).bytes);
    EXPECT_TRUE(reply.ok()) << reply.status();
    return StatusOf(reply->head);
  }
  std::vector<std::string> Done() {
    MutexLock lock(mutex_);
    return done_;
  }

  std::vector<std::string> done_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<CommandServer> server_;
};

TEST_F(CommandServerTest, ARepeatedCommandIsDoneOnce) {
  Start();
  Command(1, 1, "clear");
  EXPECT_TRUE(StatusOfReply(0).ok());
  Command(1, 1, "clear");
  EXPECT_TRUE(StatusOfReply(1).ok());
  EXPECT_EQ(Done(), (std::vector<std::string>{"clear"}));
  Command(2, 1, "clear");
  Command(1, 2, "save", 5, 7);
  EXPECT_TRUE(StatusOfReply(2).ok());
  EXPECT_TRUE(absl::IsFailedPrecondition(StatusOfReply(3)));
  EXPECT_EQ(Done(), (std::vector<std::string>{"clear", "clear", "save"}));
}

TEST_F(CommandServerTest, CommandsNameTheirDaemon) {
  Start();
  Command(1, 1, "clear", 6);
  Command(1, 2, "clear", 0);
  EXPECT_TRUE(absl::IsInvalidArgument(StatusOfReply(0)));
  Command(1, 3, "save");
  EXPECT_TRUE(StatusOfReply(1).ok());
  EXPECT_EQ(Done(), (std::vector<std::string>{"save"}));
}

TEST_F(CommandServerTest, SwitchedOffItRefusesAll) {
  Start(false);
  Command(1, 1, "save");
  Command(1, 2, "clear");
  EXPECT_TRUE(absl::IsPermissionDenied(StatusOfReply(0)));
  EXPECT_TRUE(absl::IsPermissionDenied(StatusOfReply(1)));
  EXPECT_TRUE(Done().empty());
}

}  // namespace splinemap::query_server_test
