#!/usr/bin/env bash
# The scans of a map: it is what they make, and they make it anew at other poses, times, places and
# resolutions, offline and in a daemon.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# drift FACTOR: a trajectory on stdin that drifts along x and turns, ever further.
drift() {
  awk -F, -v OFS=, -v factor="$1" 'NR == 1 { print; next }
    { $2 = sprintf("%.17g", $2 + factor * 0.002 * NR); $4 = sprintf("%.17g", $4 + factor * 0.0002 * NR); print }'
}

equal() { expect 0 splinemap diff "$1" "$2"; }
differ() { expect 1 splinemap diff "$1" "$2"; }

splinemap simulate office.lcmlog 2> /dev/null
build=(splinemap build office.lcmlog)
flags=(--scan LASER --pose POSE --name robot)
expect 0 "${build[@]}" office.splinemap "${flags[@]}"
expect 0 splinemap verify office.splinemap
expect_text "are what its" out
expect 0 splinemap verify office.splinemap --json
[[ $(jq '.layers[0].differing_tiles == 0 and .layers[0].scans > 1000' out) == true ]] ||
  fail "verify: $(cat out)"

# A map that is not what its scans make is found.
cp office.splinemap changed.splinemap
sqlite3 changed.splinemap "DELETE FROM scan_beams WHERE block = 1; DELETE FROM scan_poses WHERE block = 1"
expect 1 splinemap verify changed.splinemap
expect_text "can be read; made anew it has those alone" err

# Another trajectory and back is as before; what moves moves as if it had been mapped so.
splinemap trajectory office.splinemap > right.csv
drift 1 < right.csv > drifted.csv
expect 0 splinemap correct office.splinemap drifted.csv --out drifted.splinemap
differ office.splinemap drifted.splinemap
expect 0 splinemap verify drifted.splinemap
expect 0 splinemap correct drifted.splinemap right.csv --out again.splinemap
equal office.splinemap again.splinemap
awk -F, -v OFS=, 'NR > 1 { $1 = "5" sprintf("%015.0f", $1); print }' right.csv > other_clock.csv
expect 1 splinemap correct office.splinemap other_clock.csv --out none.splinemap
expect_text "is it on the clock of the scans?" err
printf '1,2,3\n' > bad.csv
expect 2 splinemap correct office.splinemap bad.csv --out none.splinemap
expect_text "bad.csv, line 1: utime,x_m,y_m,yaw_rad is expected" err

# Times: the parts of a drive, as of a log that has them alone.
expect 0 splinemap fold office.splinemap --until start+30s --out head.splinemap
expect 0 splinemap render office.splinemap head_at.png --at start+30s
expect 0 splinemap render head.splinemap head.png
cmp head.png head_at.png || fail "the map as it was differs from that of its scans"
expect 0 splinemap fold office.splinemap --from start+30s --out tail.splinemap
expect 0 splinemap forget office.splinemap --before start+30s --out forgotten.splinemap
equal tail.splinemap forgotten.splinemap
differ office.splinemap tail.splinemap
expect 1 splinemap forget office.splinemap --before end+1s --out none.splinemap
expect 2 splinemap query office.splinemap 1 1 --at yesterday
expect_text "yesterday is no time" err

# Resolution, sensor model, frame: as if mapped so.
expect 0 splinemap fold office.splinemap --knot-interval-m 0.1 --out coarse.splinemap
printf 'method { knot_interval_m: 0.1 }\n' > coarse.textproto
expect 0 "${build[@]}" coarse_built.splinemap "${flags[@]}" --config coarse.textproto
equal coarse.splinemap coarse_built.splinemap
expect 0 splinemap fold office.splinemap --preset paper --out paper.splinemap
printf 'method { preset: "paper" }\n' > paper.textproto
expect 0 "${build[@]}" paper_built.splinemap "${flags[@]}" --config paper.textproto
equal paper.splinemap paper_built.splinemap
expect 0 "${build[@]}" turned.splinemap "${flags[@]}" --frame 3,-2,90
expect 0 splinemap verify turned.splinemap
differ office.splinemap turned.splinemap
expect 2 "${build[@]}" none.splinemap "${flags[@]}" --frame 3,-2
expect_text "X_M,Y_M,YAW_DEG is expected" err

expect 0 splinemap layer place office.splinemap robot 3 -2 90 --out placed.splinemap
equal turned.splinemap placed.splinemap
expect 0 splinemap layer place placed.splinemap robot 0 0 0 --out back.splinemap
equal office.splinemap back.splinemap

# Merged maps keep the scans of all robots.
expect 0 splinemap build office.lcmlog other.splinemap --scan LASER --pose POSE --name other --frame 1,1,0
expect 0 splinemap merge office.splinemap other.splinemap --out both.splinemap
expect 0 splinemap verify both.splinemap
[[ $(grep -c "are what its" out) == 2 ]] || fail "verify: $(cat out)"
expect 0 splinemap layer place both.splinemap other 0 0 0 --out both_placed.splinemap
expect 0 splinemap layers both_placed.splinemap
! grep -q approximate out || fail "a layer with its scans is placed exactly: $(cat out)"
expect 2 splinemap correct both.splinemap right.csv --out none.splinemap
expect_text "say which one is to be corrected with --layer" err
expect 0 splinemap correct both.splinemap drifted.csv --layer robot --out both_corrected.splinemap

# A chair that came, and one that went.
expect 0 splinemap changes office.splinemap --since start+30s --picture changes.png
expect_text "became,x0_m,y0_m,x1_m,y1_m,area_m2" out
[[ -s changes.png ]] || fail "no picture"

# A part of the drive left out; every other scan.
expect 0 splinemap fold office.splinemap --without-region 0,0,5,5 --out without.splinemap
expect 0 splinemap fold office.splinemap --every-nth 2 --out half.splinemap
expect_text " scans, " err

# Scans that are not kept cannot be moved, and that is said.
printf 'service { max_archive_mb: 0 }\n' > none.textproto
expect 0 "${build[@]}" without_scans.splinemap "${flags[@]}" --config none.textproto
equal office.splinemap without_scans.splinemap
expect 0 splinemap verify without_scans.splinemap
expect_text "no scans to compare them with" out
expect 1 splinemap fold without_scans.splinemap --every-nth 2 --out none.splinemap
expect_text "layer robot: the map keeps no scans of it (max_archive_mb), only tiles" err

# Live: mapped with drift, corrected by a trajectory, equal to the map of the right poses.
if [[ ! -d $shared_data ]]; then
  echo "archive: recorded drives skipped, the shared data folder is not there"
  exit 0
fi
for drive in intel aces freiburg-079; do
  log=$shared_data/carmen/$drive-corrected.log.gz
  splinemap import-carmen "$log" right.lcmlog --force 2> /dev/null
  expect 0 splinemap build right.lcmlog right.splinemap "${flags[@]}" --force
  zcat "$log" | awk '/^FLASER/ { n = $2; k += 1; $(n + 3) += 0.002 * k; $(n + 5) += 0.0001 * k } { print }' \
    > drifting.log
  splinemap import-carmen drifting.log drifting.lcmlog --force 2> /dev/null
  rm -f live.splinemap
  splinemapd --map live.splinemap "${flags[@]}" 2> daemon.log &
  daemon=$!
  await splinemap watch --once --timeout 2
  lcm-logplayer -s 300 drifting.lcmlog > /dev/null
  scans=$(splinemap trajectory right.splinemap | tail -n +2 | wc -l)
  # shellcheck disable=SC2016
  await bash -c 'splinemap watch --once --json --timeout 2 > status.json &&
    (($(jq .scans_mapped status.json) >= $1))' _ "$scans"
  expect 0 splinemap correct --live "$log" --robot robot
  await grep -q "the layer was corrected by a trajectory" daemon.log
  if [[ $drive == intel ]]; then
    expect 0 splinemap layer place --live robot 5 -1 30
    expect 0 splinemap snapshot live_placed.splinemap
    expect 0 splinemap build right.lcmlog placed.splinemap "${flags[@]}" --frame 5,-1,30 --force
    equal placed.splinemap live_placed.splinemap
    expect 0 splinemap layer place --live robot 0 0 0
  fi
  kill "$daemon"
  wait "$daemon" || fail "the daemon: $(cat daemon.log)"
  grep -o "the layer was corrected.*" daemon.log
  equal right.splinemap live.splinemap
  expect 0 splinemap verify live.splinemap
done
