#include "services/viewer/access.h"

#include "services/viewer/http_target.h"

namespace splinemap::access_test {

TEST(AccessTest, OnLoopbackOnlyItsOwnNamesAndPagesMayAsk) {
  const Access access;
  for (const char* host :
       {"localhost:8086", "127.0.0.1:8086", "[::1]:8086", "127.0.0.2", "localhost"})
    EXPECT_TRUE(access.Check({.host = host}).ok()) << host;
  for (const char* host : {"", "evil.com", "evil.com:8086", "127.evil.com", "localhost.evil.com",
                           "127.0.0.1.evil.com:8086", "[::2]:80", "192.168.0.1:8086"}) {
    EXPECT_TRUE(absl::IsPermissionDenied(access.Check({.host = host}))) << host;
  }
  EXPECT_TRUE(access.Check({.host = "localhost:8086", .origin = "http://localhost:8086"}).ok());
  for (const char* origin :
       {"null", "http://evil.com", "http://localhost:8087", "http://localhost", "localhost:8086"}) {
    EXPECT_TRUE(
        absl::IsPermissionDenied(access.Check({.host = "localhost:8086", .origin = origin})))
        << origin;
  }
}

TEST(AccessTest, PicturesOfPagesOfOtherSitesAreRefused) {
  const Access access;
  for (const char* site : {"cross-site", "same-site"}) {
    EXPECT_TRUE(absl::IsPermissionDenied(access.Check({.host = "localhost", .fetch_site = site})));
  }
  for (const char* site : {"", "none", "same-origin"})
    EXPECT_TRUE(access.Check({.host = "localhost", .fetch_site = site}).ok()) << site;
}

TEST(AccessTest, ATokenIsAskedForWhereThereIsOne) {
  Access access{.is_loopback = false, .token = "0123456789abcdef"};
  EXPECT_TRUE(absl::IsUnauthenticated(access.Check({.host = "robot:8086"})));
  for (const char* wrong : {"0123456789abcde", "0123456789abcdef0", "0123456789abcdeF", ""})
    EXPECT_TRUE(absl::IsUnauthenticated(access.Check({.host = "robot", .token = wrong}))) << wrong;
  EXPECT_TRUE(access.Check({.host = "robot", .token = access.token}).ok());
  EXPECT_TRUE(access.Check({.host = "robot", .authorization = "Bearer 0123456789abcdef"}).ok());
  EXPECT_FALSE(access.Check({.host = "robot", .authorization = "Basic 0123456789abcdef"}).ok());
  // The header counts where both are there.
  EXPECT_FALSE(
      access.Check({.host = "robot", .authorization = "Bearer x", .token = access.token}).ok());
}

TEST(HttpTargetTest, PathAndParametersAreTakenApart) {
  const auto target = HttpTarget::Parse("/api/query?x=1.5&y=-2e1&name=a%20b%2f+c&flag");
  ASSERT_TRUE(target.ok());
  EXPECT_EQ(target->path, "/api/query");
  EXPECT_EQ(*target->Number("x"), 1.5);
  EXPECT_EQ(*target->Number("y"), -20);
  EXPECT_EQ(target->parameters.at("name"), "a b/ c");
  EXPECT_EQ(target->parameters.at("flag"), "");
  EXPECT_EQ(*target->NumberOr("z", 7), 7);
  EXPECT_FALSE(target->Number("z").ok());
  EXPECT_FALSE(target->Number("name").ok());
  EXPECT_FALSE(HttpTarget::Parse("/?x=inf")->Number("x").ok());
  EXPECT_FALSE(HttpTarget::Parse("/?x=nan")->NumberOr("x", 1).ok());
}

TEST(HttpTargetTest, WhatIsNoTargetIsRefused) {
  for (const char* target :
       {"", "x", "http://evil.com/", "*", "/?x=%", "/?x=%4", "/?x=%zz", "/?x=%00", "/?x=1&x=2"}) {
    EXPECT_FALSE(HttpTarget::Parse(target).ok()) << target;
  }
  EXPECT_FALSE(HttpTarget::Parse("/" + std::string(HttpTarget::kMaxBytes, 'a')).ok());
}

}  // namespace splinemap::access_test
