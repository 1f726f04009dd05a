#include "services/splinemapd/request_server.h"

#include <gtest/gtest.h>

#include <chrono>
#include <future>
#include <thread>

#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lib/rpc/encoded.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "tests/support/queries.h"
#include "tests/support/test_keys.h"

namespace splinemap::request_server_test {

using std::chrono::milliseconds;

// The server without a bus.
class RequestServerTest : public testing::Test {
 protected:
  void Start(std::shared_ptr<const KeyRing> keys = nullptr) {
    server_ = std::make_unique<RequestServer>(
        "MAP", newest_,
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
        },
        [this](const std::vector<uint8_t>& command, RequestServer::Done done) {
          const std::string name = Decode<command_request_t>(command)->command;
          {
            MutexLock lock(mutex_);
            executed_.push_back(name);
            if (name == "slow") {
              slow_ = done;
              return;
            }
          }
          done(name == "fail" ? absl::FailedPreconditionError("session 1") : absl::OkStatus());
        },
        std::move(keys));
    serving_ = std::jthread([this](const std::stop_token& stop) {
      while (!stop.stop_requested()) {
        if (!server_->NeedsServer()) std::this_thread::sleep_for(std::chrono::microseconds(100));
        server_->Serve();
      }
    });
  }

  static points_request_t Request(int64_t client, int64_t id, int64_t query = 0,
                                  int64_t nonce = 5) {
    std::mt19937_64 random(1);
    auto request =
        *Decode<points_request_t>(EncodeRequest(RandomPoints(random, 100), {0, 100}, request_t()));
    request.header.client = client;
    request.header.id = id;
    request.header.query = query;
    request.header.daemon_nonce = nonce;
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
  static reply_t Header(const Reply& reply) {
    const auto decoded = Decode<points_reply_t>(reply.bytes);
    EXPECT_TRUE(decoded.ok()) << decoded.status();
    return decoded.ok() ? decoded->header : reply_t{};
  }

  // The daemon's nonce is 5.
  static LayerSnapshot OwnLayer(uint64_t seed, uint64_t revision) {
    return {{"robot", 1}, {1, 5}, revision, RandomMap(seed)->tiles};
  }
  void SetMap(uint64_t seed, uint64_t revision) { newest_.SetOwn(OwnLayer(seed, revision)); }
  // Replies wait until Open().
  void Shut() {
    MutexLock lock(mutex_);
    gate_ = opens_.get_future().share();
  }
  void Open() { opens_.set_value(); }

  Mutex mutex_;
  ConditionVariable replied_;
  std::vector<Reply> replies_ ABSL_GUARDED_BY(mutex_);
  std::shared_future<void> gate_ ABSL_GUARDED_BY(mutex_);
  std::promise<void> opens_;
  std::vector<std::string> executed_ ABSL_GUARDED_BY(mutex_);
  RequestServer::Done slow_ ABSL_GUARDED_BY(mutex_);
  NewestMap newest_{RandomMap(1)->options, OwnLayer(1, 20)};
  std::unique_ptr<RequestServer> server_;
  std::jthread serving_;
};

TEST_F(RequestServerTest, RepliesToWhoAskedWithWhoAnswers) {
  Start();
  server_->Handle(Encode(Request(0xabc, 17)));
  const Reply reply = Await(1).at(0);
  EXPECT_EQ(reply.channel, "MAP_REPLIES_0000000000000abc");
  const auto decoded = Decode<points_reply_t>(reply.bytes);
  ASSERT_TRUE(decoded.ok());
  EXPECT_EQ(decoded->header.id, 17);
  EXPECT_EQ(decoded->header.name, "robot");
  EXPECT_EQ(decoded->header.daemon_nonce, 5);
  EXPECT_EQ(decoded->header.session_number, 1);
  EXPECT_EQ(decoded->header.revision, 20);
  const points_request_t request = Request(0xabc, 17);
  for (size_t k = 0; k < 100; ++k) {
    EXPECT_EQ(decoded->log_odds.at(k),
              RandomMap(1)->Evaluate(request.x_m[k], request.y_m[k]).log_odds);
  }
}

TEST_F(RequestServerTest, AnotherNonceIsIgnoredAndNoneMeansAnybody) {
  Start();
  server_->Handle(Encode(Request(1, 1, 0, 6)));
  server_->Handle(Encode(Request(1, 2, 0, 0)));
  EXPECT_EQ(Header(Await(1).at(0)).id, 2);
  EXPECT_EQ(server_->counts().for_others, 1);
}

TEST_F(RequestServerTest, RequestsOfOneQueryAreAnsweredFromOneState) {
  Start();
  server_->Handle(Encode(Request(1, 1, 9)));
  Await(1);
  SetMap(2, 21);
  server_->Handle(Encode(Request(1, 2, 9)));  // the same query
  Await(2);
  server_->Handle(Encode(Request(2, 3, 9)));  // of another client
  Await(3);
  server_->Handle(Encode(Request(1, 4, 10)));  // another query
  Await(4);
  server_->Handle(Encode(Request(1, 5)));  // one that is alone
  Await(5);
  server_->Handle(Encode(Request(1, 6, 9)));  // the first query, after the newest went on
  const std::vector<Reply> replies = Await(6);
  EXPECT_EQ(replies[1].bytes.size(), replies[0].bytes.size());
  EXPECT_EQ(Header(replies[1]).revision, 20);
  EXPECT_EQ(Decode<points_reply_t>(replies[1].bytes)->log_odds,
            Decode<points_reply_t>(replies[0].bytes)->log_odds);
  EXPECT_EQ(Header(replies[2]).revision, 21);
  EXPECT_EQ(Header(replies[3]).revision, 21);
  EXPECT_EQ(Header(replies[4]).revision, 21);
  EXPECT_EQ(Header(replies[5]).revision, 20);
  EXPECT_EQ(Decode<points_reply_t>(replies[5].bytes)->log_odds,
            Decode<points_reply_t>(replies[0].bytes)->log_odds);
  EXPECT_NE(Decode<points_reply_t>(replies[4].bytes)->log_odds,
            Decode<points_reply_t>(replies[0].bytes)->log_odds);
}

TEST_F(RequestServerTest, OneClientThatAsksMuchDoesNotStarveAnother) {
  Start();
  Shut();
  for (int64_t id = 0; id < 5000; ++id) server_->Handle(Encode(Request(1, id)));
  server_->Handle(Encode(Request(2, 1)));
  Open();
  const std::vector<Reply> replies = Await(6);
  const auto second = std::find_if(replies.begin(), replies.begin() + 6, [](const Reply& reply) {
    return reply.channel == "MAP_REPLIES_0000000000000002";
  });
  ASSERT_NE(second, replies.begin() + 6) << "in its turn";
  EXPECT_EQ(Header(*second).status, 0);
  EXPECT_GE(server_->counts().refused, 5000 - 65);
  // As many refusals as wait, and no more.
  const std::vector<Reply> all = Await(65 + 16);
  std::this_thread::sleep_for(milliseconds(50));
  int64_t refused = 0;
  for (const Reply& reply : Await(all.size())) {
    refused += absl::IsResourceExhausted(StatusOf(Header(reply))) ? 1 : 0;
  }
  EXPECT_GE(refused, 16);
  EXPECT_LE(refused, 17);
}

TEST_F(RequestServerTest, AFloodOfNewIdsDoesNotTakeTheStateOfAQueryAway) {
  Start();
  server_->Handle(Encode(Request(1, 1, 9)));
  server_->Handle(Encode(Request(1, 2, 9)));
  size_t asked = 2;
  Await(asked);
  SetMap(2, 21);
  for (int64_t stranger = 100; stranger < 200; ++stranger) {
    server_->Handle(Encode(Request(stranger, 1, 9)));
    if (++asked % 10 == 0) Await(asked);  // more would be refused
  }
  Await(asked);
  server_->Handle(Encode(Request(1, 3, 9)));
  EXPECT_EQ(Header(Await(++asked).back()).revision, 20);
}

TEST_F(RequestServerTest, LargeAndDamagedMessagesDoNoHarm) {
  Start();
  points_request_t large = Request(1, 1);
  large.num_points = 5000;
  large.x_m.resize(5000);
  large.y_m.resize(5000);
  server_->Handle(Encode(large));
  EXPECT_TRUE(absl::IsInvalidArgument(StatusOf(Header(Await(1).at(0)))));
  const std::vector<uint8_t> whole = Encode(Request(1, 2));
  for (size_t size = 0; size < whole.size(); ++size) server_->Handle({whole.data(), size});
  std::vector<uint8_t> forged = whole;
  forged[8 + 32 + 1] = 0x7f;  // the count
  server_->Handle(forged);
  server_->Handle(Encode(Request(1, 3)));
  const std::vector<Reply> replies = Await(2);
  EXPECT_EQ(Header(replies.at(1)).id, 3);
  EXPECT_GT(server_->counts().malformed, 40);
}

TEST_F(RequestServerTest, OneThreadServesAtATime) {
  Start();
  Shut();
  server_->Handle(Encode(Request(1, 1)));
  while (server_->steps().count() % 2 != 0) std::this_thread::yield();  // until it is served
  server_->Handle(Encode(Request(1, 2)));
  EXPECT_FALSE(server_->NeedsServer());
  server_->Serve();  // returns, though the gate is shut
  Open();
  EXPECT_EQ(Header(Await(2).at(1)).id, 2);
  while (server_->steps().count() % 2 == 0) std::this_thread::yield();
}

TEST_F(RequestServerTest, StoppedItServesNothing) {
  Start();
  server_->Stop();
  server_->Handle(Encode(Request(1, 1)));
  EXPECT_FALSE(server_->NeedsServer());
  server_->Serve();
  std::this_thread::sleep_for(std::chrono::milliseconds(50));  // for what must not come
  EXPECT_EQ(Await(0).size(), 0u);
}

class CommandTest : public RequestServerTest {
 protected:
  explicit CommandTest(std::shared_ptr<const KeyRing> keys = nullptr) { Start(std::move(keys)); }
  static std::vector<uint8_t> CommandBytes(int64_t client, int64_t id, const std::string& command,
                                           int64_t nonce = 5) {
    command_request_t request{};
    request.header.client = client;
    request.header.id = id;
    request.header.daemon_nonce = nonce;
    request.command = command;
    return Encode(request);
  }
  void Command(int64_t client, int64_t id, const std::string& command, int64_t nonce = 5) {
    server_->Handle(CommandBytes(client, id, command, nonce));
  }
  absl::Status StatusOfReply(size_t number) {
    const auto reply = Decode<command_reply_t>(Await(number + 1).at(number).bytes);
    EXPECT_TRUE(reply.ok()) << reply.status();
    return StatusOf(reply->header);
  }
  std::vector<std::string> Executed() {
    MutexLock lock(mutex_);
    return executed_;
  }
};

TEST_F(CommandTest, ARepeatedCommandIsExecutedOnceAndGetsTheReplyThatThereWas) {
  Command(1, 1, "clear");
  EXPECT_TRUE(StatusOfReply(0).ok());
  Command(1, 1, "clear");
  EXPECT_TRUE(StatusOfReply(1).ok());
  EXPECT_EQ(Executed(), (std::vector<std::string>{"clear"}));
  Command(2, 1, "clear");
  EXPECT_TRUE(StatusOfReply(2).ok());
  Command(1, 2, "fail");
  EXPECT_TRUE(absl::IsFailedPrecondition(StatusOfReply(3)));
  EXPECT_EQ(Executed(), (std::vector<std::string>{"clear", "clear", "fail"}));
}

TEST_F(CommandTest, CommandsNameTheirDaemon) {
  Command(1, 1, "clear", 6);
  Command(1, 2, "clear", 0);
  EXPECT_TRUE(absl::IsInvalidArgument(StatusOfReply(0)));
  Command(1, 3, "save");
  EXPECT_TRUE(StatusOfReply(1).ok());
  EXPECT_EQ(Executed(), (std::vector<std::string>{"save"}));
}

TEST_F(CommandTest, ASlowCommandKeepsNobodyWaitingAndIsNotExecutedAgainMeanwhile) {
  Command(1, 1, "slow");
  Command(1, 1, "slow");
  server_->Handle(Encode(Request(2, 1)));
  EXPECT_EQ(Header(Await(1).at(0)).id, 1) << "the query was answered";
  RequestServer::Done done;
  {
    MutexLock lock(mutex_);
    done = slow_;
  }
  done(absl::OkStatus());
  EXPECT_TRUE(StatusOfReply(1).ok());
  Command(1, 1, "slow");
  EXPECT_TRUE(StatusOfReply(2).ok());
  EXPECT_EQ(Executed(), (std::vector<std::string>{"slow"}));
}

TEST_F(CommandTest, SlowCommandsBeyondALimitAreRefused) {
  for (int64_t id = 0; id < 17; ++id) Command(1, id, "slow");
  EXPECT_TRUE(absl::IsResourceExhausted(StatusOfReply(0)));
  EXPECT_EQ(Executed().size(), 16u);
}

class SignedCommandTest : public CommandTest {
 protected:
  enum Who { kDaemon, kLaptop, kViewer, kStranger };
  SignedCommandTest() : CommandTest(Ring(kDaemon)) {}

  static std::shared_ptr<const KeyRing> Ring(Who who) {
    const auto key = [](Who whose) { return PublicKeyOf(TestSecret(whose)); };
    return *KeyRing::Make(TestSecret(who), {{"robot", key(kDaemon), {"robot"}, false, false},
                                            {"laptop", key(kLaptop), {}, false, true},
                                            {"viewer", key(kViewer), {}, false, false}});
  }
  static std::vector<uint8_t> Signed(Who who, int64_t client, int64_t id,
                                     const std::string& command) {
    return splinemap::Signed(Ring(who).get(), "MAP_COMMAND_REQUESTS",
                             CommandBytes(client, id, command));
  }
  // Whether it is the daemon's, for who knows its key.
  bool IsBelieved(size_t number) {
    const Reply reply = Await(number + 1).at(number);
    return Ring(kLaptop)->SignerOf(reply.channel, reply.bytes).ok();
  }
};

TEST_F(SignedCommandTest, AreExecutedForWhoDecides) {
  server_->Handle(Signed(kLaptop, 1, 1, "clear"));
  EXPECT_TRUE(StatusOfReply(0).ok());
  EXPECT_TRUE(IsBelieved(0));
  server_->Handle(Signed(kViewer, 1, 2, "clear"));
  EXPECT_TRUE(absl::IsPermissionDenied(StatusOfReply(1)));
  EXPECT_TRUE(IsBelieved(1));
  server_->Handle(Signed(kDaemon, 1, 3, "clear"));
  EXPECT_TRUE(absl::IsPermissionDenied(StatusOfReply(2))) << "who maps does not decide";
  EXPECT_EQ(Executed(), (std::vector<std::string>{"clear"}));
}

// Those that somebody else may have changed are refused without a signature, so that nobody is told
// that what was executed was refused.
TEST_F(SignedCommandTest, AreRefusedWhereTheyAreForged) {
  std::vector<uint8_t> forged = Signed(kLaptop, 1, 1, "clear");
  forged[forged.size() - kSignatureBytes - 1] ^= 1;  // the session
  const std::vector<std::vector<uint8_t>> commands{
      CommandBytes(1, 1, "clear"), Signed(kStranger, 1, 1, "clear"), forged,
      splinemap::Signed(Ring(kLaptop).get(), "OTHER_COMMAND_REQUESTS",
                        CommandBytes(1, 1, "clear"))};
  for (size_t k = 0; k < commands.size(); ++k) {
    server_->Handle(commands[k]);
    Await(k + 1);
  }
  for (size_t k = 0; k < 4; ++k) {
    EXPECT_TRUE(absl::IsPermissionDenied(StatusOfReply(k))) << k;
    EXPECT_FALSE(IsBelieved(k)) << k;
  }
  server_->Handle(Signed(kLaptop, 1, 1, "save"));
  EXPECT_TRUE(StatusOfReply(4).ok()) << "its turn was not taken";
  EXPECT_EQ(Executed(), (std::vector<std::string>{"save"}));
  EXPECT_EQ(server_->counts().disbelieved, 4);
}

TEST_F(SignedCommandTest, AreExecutedOnceHoweverOftenAndLateTheyAreSent) {
  const std::vector<uint8_t> recorded = Signed(kLaptop, 1, 1, "clear");
  server_->Handle(recorded);
  Await(1);
  for (int64_t id = 2; id < 200; ++id) {  // more than there are replies that are remembered
    server_->Handle(Signed(kLaptop, 1, id, "save"));
    Await(static_cast<size_t>(id));
  }
  server_->Handle(recorded);
  EXPECT_TRUE(absl::IsFailedPrecondition(StatusOfReply(199)));
  const std::vector<std::string> executed = Executed();
  EXPECT_EQ(std::count(executed.begin(), executed.end(), "clear"), 1);
  EXPECT_EQ(executed.size(), 199u);
}

TEST_F(SignedCommandTest, QueriesNeedNoKeyAndTheirRepliesAreSigned) {
  server_->Handle(Encode(Request(2, 1)));
  EXPECT_EQ(Header(Await(1).at(0)).id, 1);
  EXPECT_TRUE(IsBelieved(0));
  server_->Handle(
      splinemap::Signed(Ring(kStranger).get(), "MAP_POINTS_REQUESTS", Encode(Request(2, 2))));
  EXPECT_EQ(Header(Await(2).at(1)).id, 2);
}

}  // namespace splinemap::request_server_test
