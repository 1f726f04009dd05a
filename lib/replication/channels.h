#pragma once

#include "lcmtypes/splinemap/control_records_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/stand_in_digest_t.hpp"

namespace splinemap {

// What the channel of a message ends in, after the prefix.
inline constexpr const char* kDigestChannel = "_DIGESTS";
inline constexpr const char* kStandInChannel = "_STAND_INS";
inline constexpr const char* kUpdateChannel = "_UPDATES";
inline constexpr const char* kListingChannel = "_LISTINGS";
inline constexpr const char* kPullChannel = "_PULLS";
inline constexpr const char* kControlChannel = "_CONTROL";
// Those of all who follow.
inline constexpr const char* kFollowedChannels[] = {kDigestChannel, kStandInChannel,
                                                    kUpdateChannel, kListingChannel,
                                                    kPullChannel,   kControlChannel};

inline const char* ChannelOf(const layer_digest_t&) { return kDigestChannel; }
inline const char* ChannelOf(const stand_in_digest_t&) { return kStandInChannel; }
inline const char* ChannelOf(const layer_updates_t&) { return kUpdateChannel; }
inline const char* ChannelOf(const layer_listing_t&) { return kListingChannel; }
inline const char* ChannelOf(const layer_pull_t&) { return kPullChannel; }
inline const char* ChannelOf(const control_records_t&) { return kControlChannel; }

}  // namespace splinemap
