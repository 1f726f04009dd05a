#!/usr/bin/env bash
# run.sh [NAME..]: breaks each rule of the protocol of followers (lcmtypes/FOLLOWING.md), one at a time, in
# a copy of the sources, and fails where the tests of the protocol do not notice. Some minutes.
set -euo pipefail
cd "$(dirname "$(readlink -f "$0")")/../.."

copy=build/mutation/source
mkdir -p "$copy"
git ls-files -z --cached --others --exclude-standard | xargs -0 cp -u --parents -t "$copy"
[[ -f build/mutation/build/build.ninja ]] ||
  cmake -S "$copy" -B build/mutation/build -G Ninja -DCMAKE_BUILD_TYPE=Dev > /dev/null

tests() {
  ninja -C build/mutation/build replication_test > build/mutation/log.txt 2>&1 || return 2
  timeout 300 build/mutation/build/tests/replication_test --gtest_brief=1 --gtest_fail_fast \
    > build/mutation/log.txt 2>&1
}

survivors=0
broken=0
# mutate NAME FILE PATTERN REPLACEMENT: PATTERN is a Perl regular expression over the whole file.
mutate() {
  local name=$1 file=$copy/$2
  ((${#chosen[@]} == 0)) || [[ " ${chosen[*]} " == *" $name "* ]] || return 0
  cp "$file" build/mutation/kept
  P=$3 R=$4 perl -0pi -e 's/$ENV{P}/$ENV{R}/' "$file"
  if cmp -s "$file" build/mutation/kept; then
    echo "$name: nothing to break; the pattern is out of date" >&2
    exit 2
  fi
  local status=0
  tests || status=$?
  cp build/mutation/kept "$file"
  broken=$((broken + 1))
  case $status in
    0) survivors=$((survivors + 1)); echo "$name: NOT NOTICED" ;;
    2) tail -n 20 build/mutation/log.txt >&2; echo "$name: does not compile" >&2; exit 2 ;;
    *) echo "$name: $(grep -m 1 -oE '(FAILED  \]|error:|Assertion) [^ ]*' build/mutation/log.txt |
      sed 's/FAILED  \] //' || echo "status $status")" ;;
  esac
}

chosen=("$@")
tests || { tail -n 20 build/mutation/log.txt >&2; echo "the tests fail as it is" >&2; exit 2; }

follower=lib/replication/layer_follower.cc
publisher=lib/replication/layer_publisher.cc
pyramid=lib/replication/pyramid_publisher.cc
guard=lib/replication/session_guard.cc
proxy=lib/replication/proxy_publisher.cc
gossip=lib/replication/settings_gossip.cc
following=lib/replication/map_follower.cc
settings=lib/layers/layer_settings.cc
sum=lib/map/summed_layers.cc
placed=lib/map/placed_tile.cc
intake=lib/replication/scan_intake.cc
scans=lib/replication/scan_publisher.cc

mutate tiles_that_are_later_have_the_scan "$follower" 'tiles_\.tree\(\)\.RevisionOf\(key\) >= scan\.revision' 'false'
mutate tiles_are_not_taken_while_folding "$follower" ' \|\| IsFolding\(\)\) return;' ') return;'
mutate digests_are_compared_at_their_commit "$follower" 'digest_is_ahead_ && \*folded_ ==' 'false && *folded_ =='
mutate hashes_that_differ_end_folding "$follower" '\(!is_overtaken && !subset_\.box && !Matches\(\)\)' 'false'
mutate overtaken_digests_end_folding "$follower" 'overtaken_digests_ >= kMaxOvertakenDigests' 'false'
mutate misfolds_in_a_row_take_tiles "$follower" '\+\+misfolds_ >= kMaxMisfolds' 'false'
mutate scans_are_tried_again "$follower" 'if \(no_scans_until_ && now >= \*no_scans_until_\) no_scans_until_\.reset\(\);' ''
mutate scans_beyond_a_digest_are_forgotten "$follower" 'if \(is_owners\) intake_\.ForgetAfter\(revision\);' ''
mutate scans_that_are_gone_come_as_tiles "$follower" 'if \(is_lost\) StopFolding\(\);' ''
mutate parts_find_other_folds "$follower" 'if \(revision <= \*folded_ && known <= revision\) CountMisfold\(now\);' ''
mutate pushes_of_tiles_are_asked_for lib/replication/layer_follower.h '\(sends_scans_ && !TakesScans\(\)\)' 'false'
mutate empty_messages_of_scans_tell_nothing "$follower" ' && !scans\.scans\.empty\(\)' ''
mutate lost_scans_are_asked_for "$intake" 'if \(!gap_ \|\| gap_->due > now\) return std::nullopt;' 'return std::nullopt;'
mutate others_pulls_of_scans_postpone "$intake" 'if \(!gap_\) return;' 'return;'
mutate gone_scans_are_told "$scans" 'lacks_pulled_ \|= first < Oldest\(\);' ''
mutate few_messages_of_scans_go_at_once "$scans" 'budget\.MayPush\(\) && batch\.num_messages\(\) < kMaxMessagesAtOnce' 'budget.MayPush()'
mutate old_scans_are_given_up "$scans" 'now - waiting_\.front\(\)\.since > kMaxScanWait' 'false'
mutate digests_wait_for_the_layer "$pyramid" '/\*may_digest=\*/!IsBehind\(\)' 'true'
mutate who_keeps_no_scans_does_not_answer "$pyramid" 'if \(!options_\.sends_scans && !options_\.proxy\) return;' ''
mutate tiles_are_pushed_to_who_asks "$publisher" 'if \(pull\.num_nodes == 0\) tiles_wanted_ = now;' ''
mutate pushes_of_tiles_end "$publisher" 'now - \*tiles_wanted_ <= kTileLease' 'true'
mutate scanners_do_not_march lib/mapping/scan_folder.cc 'way_m > kMaxWayKnots \* options_\.knot_interval_m' 'false'
mutate own_messages_are_ignored "$following" 'if \(SpeakerOf\(message\) == speaker_\) return false;' ''
mutate owner_is_told_by_its_speaker lib/replication/protocol.h 'digest\.speaker == digest\.layer\.session_nonce' 'true'
mutate publishers_name_their_speaker "$publisher" 'digest\.speaker = speaker_;' ''
mutate greater_session_replaces "$follower" 'ref\.session > \*session_\) StartSession' 'false) StartSession'
mutate session_begins_empty "$follower" 'tiles_ = TileTreeEditor\(\);\n  index_ = \{\};' ''
mutate lesser_session_is_ignored "$follower" 'if \(session_ && ref\.session < \*session_\)' 'if (false)'
mutate only_the_present_session_counts "$follower" 'session_ && ref\.session == \*session_ && ref' 'ref'
mutate newest_revision_wins "$follower" 'update\.revision < least' 'update.revision < least && false'
mutate session_number_is_greater_than_heard "$guard" 'heard \+ 1' 'own.session.number + 1'
mutate lesser_owner_takes_another_origin "$guard" 'next\.ref\.id\.origin = random;' ''
mutate follower_tells_of_a_later_session "$follower" 'next_objection_ = now \+ random_\.UpTo\(kObjection\);' ''
mutate followers_word_waits_for_owners "$guard" 'is_heard_for\(known_, kMinKnown\)' 'known_.has_value()'
mutate pull_of_another_session_is_ignored "$pyramid" 'ref\.id != ref_\.id \|\| ref\.session != ref_\.session \|\|' ''
mutate differences_are_no_chain "$publisher" 'base = at_digest_\.Find\(key\)' 'base = published_.tree().Find(key)'
mutate answers_are_no_differences "$publisher" 'Publish\(key, false\)' 'Publish(key, true)'
mutate pushes_after_an_answer_are_whole "$publisher" '!answered_\.contains\(key\)' 'true'
mutate result_has_the_checksum lib/tiles/tile_codec.cc 'TileChecksum\(update\.key, tile\) != update\.checksum' 'false'
mutate hash_is_of_the_present_tiles lib/replication/hash_tree.cc 'hash_ \+= change' 'hash_ += checksum'
mutate digest_is_of_what_is_published "$publisher" 'digest\.hash = static_cast<int64_t>\(index_\.hash\(\)\)' 'digest.hash = 1'
mutate other_version_is_not_followed "$follower" 'digest\.protocol_version != kProtocolVersion' 'false'
mutate overtaken_digests_are_ignored "$follower" 'owners_digest_ && WasOvertaken\(digest, \*owners_digest_\)' 'false'
mutate digests_are_not_late_for_ever "$follower" 'now - owners_digest_heard_ <= kMaxLateness' 'true'
mutate check_covers_all_quarters "$follower" 'for \(const int32_t x : \{-1, 0\}\)' 'for (const int32_t x : {0})'
mutate what_differs_is_pulled "$follower" 'Want\(child, revision, now\);' ''
mutate asks_are_repeated "$follower" 'wanted\.due = now \+ kRetry' 'wanted.due = now + 1000000 * kRetry'
mutate who_hears_an_ask_waits "$follower" 'now \+ kRetry \+ random_\.UpTo\(kMaxBackOff\)' 'now'
mutate followers_ask_at_random_times "$follower" 'wanted\.due = now \+ random_\.UpTo\(kMaxBackOff\)' 'wanted.due = now'
mutate nothing_is_asked_while_all_is_there "$follower" 'Matches\(\) \|\| !pending_\.empty\(\)' '!pending_.empty()'
mutate old_session_is_shown_until_the_new_is_whole "$follower" 'previous_ \? \*previous_ : OwnSnapshot\(\)' 'OwnSnapshot()'
mutate equal_tiles_are_not_sent_again "$follower" 'previous_index_\.HashOf\(child\) == hash\)' 'false)'
mutate cap_on_pushes "$publisher" '!changes_\.empty\(\) && budget\.MayPush\(\)' '!changes_.empty()'
mutate cap_on_answers "$publisher" '!pulled_tiles_\.empty\(\) && budget\.MayAnswer\(\)' '!pulled_tiles_.empty()'
mutate oldest_change_first "$publisher" 'change = changes_\.front\(\);\n    const TileKey key = change\.key;\n    changes_\.pop_front' 'change = changes_.back(); const TileKey key = change.key; changes_.pop_back'
mutate owners_leave_when_all_is_known "$publisher" 'digests_of_state_ >= kDigestsOfKnownState &&[^;]*;' 'true;'
mutate who_comes_asks_who_is_there "$following" 'calls_ < kCalls && now >= next_call_' 'false'
mutate who_is_there_is_answered "$publisher" 'last_digest_\.reset\(\);' ';'
mutate proxies_wait_for_silence "$proxy" 'copy_\.OwnerIsSilent\(now\) && !copy_' '!copy_'
mutate owners_are_heard_before_proxies "$follower" '!OwnerIsSilent\(now\)\) return;' 'false) return;'
mutate who_has_more_is_proxy "$proxy" 'if \(OtherLacksSomething\(now\)\) BeginBy\([^;]*;' ''
mutate one_proxy_is_enough "$proxy" 'LeaveItToOthers\(now\);  // one' ';  // one'
mutate proxies_take_over "$proxy" 'due_ = now \+ LayerFollower' 'due_ = now + 1000 * LayerFollower'
mutate session_that_was_never_whole_is_given_up "$follower" 'silence > kGiveUpSession' 'false'
mutate one_digest_replaces_no_session "$follower" ' \|\| \(previous_ && !is_established_\)' ''
mutate mistaken_session_is_given_up "$follower" 'silence > kGiveUpOnProbation' 'false'
mutate mistaken_session_is_not_told_of "$follower" 'else if \(!is_established_\)' 'else if (false)'
mutate tiles_that_the_owner_lacks_are_dropped "$follower" 'if \(IsDisowned\(key, tiles_' 'if (false && IsDisowned(key, tiles_'
mutate tiles_that_the_owner_disowns_are_fetched "$follower" 'disowned_\[key\] = revision;' 'return false;'
mutate tiles_beyond_the_roots_are_looked_at "$follower" 'index_\.root_level\(\) > root_level' 'false'
mutate clamps_are_checked_on_arrival "$follower" '!CheckTile\(key, \*tile, limits\)\.ok\(\)' '(!CheckTile(key, *tile, limits).ok() && false)'
mutate revisions_far_ahead_are_refused "$follower" 'update\.revision > static_cast<uint64_t>\(digest_->revision\) \+ kMaxAhead' 'false'
mutate silent_owners_push_nothing "$follower" 'owner_is_silent_ && !pending_' 'false && !pending_'
mutate nobody_vouches_for_what_came_last "$follower" 'owner_is_silent_\) DropWhatCameLast\(\)' 'owner_is_silent_) (void)0'
mutate one_digest_is_no_other_owner "$guard" 'is_heard_for\(other_owner_, kMinPresence\)' 'other_owner_.has_value()'
mutate starts_do_not_jump "$guard" 'heard > own\.session\.number \+ LayerSettings::kMaxSessionsAhead' 'false'
mutate digests_do_not_jump "$following" 'ref\.session\.number > \*known \+ LayerSettings::kMaxSessionsAhead' 'false'
mutate counters_do_not_jump "$gossip" 'setting\.counter <= greatest \+ LayerSettings::kMaxSettingsAhead' 'true'
mutate removals_do_not_jump "$gossip" 'if \(session_number && ' 'if (false && '
mutate made_up_removals_are_dropped "$gossip" 'settings_\.Erase\(id\);\n  return true;' 'return false;'
mutate strangers_are_bounded "$gossip" 'strangers_\.size\(\) >= kMaxStrangers' 'false'
mutate strangers_expire "$gossip" 'now - since < kStrangersStay' 'true'
mutate strangers_do_not_come_back "$gossip" 'expired_\.contains\(id\)\) continue' 'false) continue'
mutate bus_decides_where_it_may "$following" 'if \(!options_\.takes_settings\)' 'if (false)'
mutate most_layers_decide_options "$following" 'if \(map_options_ && votes_for[^;]*;' 'if (map_options_ && votes_for(options) > 0) return;'
mutate empty_layers_make_room "$following" '&& !MakeRoom\(now\)' ''
mutate empty_layers_are_forgotten "$following" 'copy\.IsEmpty\(\) && Seconds' 'false && Seconds'
mutate announced_layers_are_missing "$following" 'if \(layers_\.contains\(id\) \|\| told_' 'if (true || layers_.contains(id) || told_'
mutate announced_layers_are_followed_ones "$following" '\|\| !IsFollowed\(id\)\) continue' ') continue'
mutate announced_and_removed_is_not_missing "$following" 'settings\(\)\.Of\(id\)\.IsRemoved\(announced\.session\)' 'false'
mutate who_asks_has_not_caught_up "$following" 'calls_ == kCalls && !layers\.empty' '!layers.empty'
mutate own_layer_is_not_followed "$following" 'keeper_ && id == keeper_->own_layer\) return false' 'false) return false'
mutate removed_sessions_are_ignored "$following" 'settings\(\)\.Of\(ref\.id\)\.IsRemoved\(ref\.session\)' 'false'
mutate removed_copies_are_dropped "$following" 'const bool is_removed = [^;]*;' 'const bool is_removed = false;'
mutate removals_are_not_undone "$settings" 'std::max\(a\.removed_up_to, b\.removed_up_to\)' 'merged.removed_up_to'
mutate removal_takes_later_starts "$settings" 'session\.number \| \(kSessionsPerGeneration - 1\)' 'session.number'
mutate last_writer_wins "$settings" 'rank\(a\) < rank\(b\) \? b : a' 'a'
mutate other_settings_are_answered "$gossip" 'else if \(!records_due_\)' 'else if (false)'
mutate hash_of_settings_is_told "$gossip" '!heard_same_ && !told_ && now >= hash_due_' 'false'
mutate muted_layers_are_left_out "$sum" 'if \(!setting\.IsSummed\(\)\)' 'if (false)'
mutate layers_of_low_weight_weigh_less "$sum" '\(summand\.low_weight \? low : tiles\)' '(tiles)'
mutate another_placement_sums_anew "$sum" 'before\.placement != summand\.placement' 'false'
mutate placed_tiles_are_of_all_that_they_cover "$placed" 'box\.i1 >> 5; \+\+tx\) \{' 'box.i0 >> 5; ++tx) {'
mutate places_beside_need_neighbours "$placed" 'is_exact_ \? 0 : 2' '0'
mutate placed_minima_are_of_all_squares "$placed" '\+ finer_;' ';'
mutate nothing_swings_over "$placed" 'std::clamp<int64_t>\(value, least, greatest\)' '(value)'
mutate part_is_compared "$follower" 'checked->second == hash' 'true'
mutate part_ends_where_it_ends "$follower" 'if \(IsOutside\(child\)\) return true;' ''
mutate levels_are_kept_while_asked_for "$follower" '\*next_renewal_ <= now \|\|' ''
mutate who_is_heard_is_not_adopted "$follower" '\(layer\.session < \*session_ \|\| !OwnerIsSilent\(now\)\)' '(layer.session < *session_)'
mutate an_older_session_is_not_adopted "$follower" '\(layer\.session < \*session_ \|\| !OwnerIsSilent\(now\)\)' '(!OwnerIsSilent(now))'
mutate older_tiles_are_not_adopted "$follower" ' \|\| \(ours != nullptr && ours->revision >= theirs->revision\)' ''
mutate removed_layers_are_not_adopted "$following" '!IsFollowed\(layer\.id\) \|\| settings\(\)\.Of\(layer\.id\)\.IsRemoved\(layer\.session\)' '!IsFollowed(layer.id)'
mutate levels_are_given_up "$pyramid" 'now - asked\.second\.last > kLevelLease' 'false'
mutate levels_follow_changes lib/layers/layer_pyramid.cc '\(key\.tx & 1\) != 0 \? 1 : -1' '(key.tx & 1) != 0 ? -1 : 1'

echo "$broken rules broken, $survivors not noticed"
((survivors == 0))
