#!/usr/bin/env bash
# Small inputs that are easily got wrong, with the right values: see the README of the cases in the
# shared data folder.
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

cases=$shared_data/cases
if [[ ! -d $cases ]]; then
  echo "cases: skipped, $cases is not there"
  exit 0
fi

# log_of CASE: sets log, of a CARMEN log after its import.
log_of() {
  log=$cases/$1.lcmlog.gz
  [[ ! -f $cases/$1.log.gz ]] || {
    log=$1.lcmlog
    expect 0 splinemap import-carmen "$cases/$1.log.gz" "$log" --force
    cp err import.txt
  }
}
# maps CASE OFF [FLAG..]: it is mapped with these flags, and so many points at most are off the walls.
maps() {
  local occupied off
  log_of "$1"
  expect 0 splinemap build "$log" map.splinemap --force "${@:3}"
  cp err build.txt
  expect 0 splinemap export map.splinemap map --format csv --force
  read -r occupied off < <("$top/tests/support/off_walls.py" map.csv)
  ((occupied > 1000 && off <= $2)) || fail "$1: $off of $occupied points are off the walls"
}
# proposes CASE FLAGS: doctor does so.
proposes() {
  log_of "$1"
  expect 0 splinemap doctor "$log" --json
  [[ $(jq -r '.chosen_flags | join(" ")' out) == "$2" ]] || fail "$1: $(cat out)"
}
# says CASE STATUS TEXT: doctor does so.
says() {
  log_of "$1"
  expect "$2" splinemap doctor "$log"
  grep -qF -- "$3" out err || fail "$1: no '$3' in: $(cat out err)"
}

# All is well without a flag, and doctor leaves it so.
for name in byte_order_mark mac_line_ends one_flaser_many_robotlaser robotlaser_max_8m \
  sick_401_beams_100deg upside_down poses_heard_1.2s_late poses_then_scans pose_jump_1000km; do
  maps "$name" 0
  proposes "$name" "--scan LASER --pose POSE"
done
maps poses_then_scans 0
grep -q "mapped 1800 of 1800 scans" build.txt || fail "poses_then_scans: $(cat build.txt)"
maps one_flaser_many_robotlaser 0
grep -q "mapped 40 of 40 scans" build.txt || fail "one_flaser_many_robotlaser: $(cat build.txt)"
says pose_jump_1000km 0 "jump from (1000002.0, -999996.7) m to (2.0, 3.2) m"
maps pose_jump_1000km 0
grep -q "which no robot does" build.txt || fail "pose_jump_1000km: $(cat build.txt)"

# What doctor proposes makes the right map.
while read -r name flags; do
  proposes "$name" "$flags"
  # shellcheck disable=SC2086  # flags are words
  maps "$name" 0 $flags
done << 'EOT'
no_return_29.995m --scan LASER:bot_core,range_max_m=29.97 --pose POSE
flaser_all_round --scan LASER:bot_core,fov_deg=360 --pose POSE
scan_stamps_in_ms --scan LASER:bot_core,stamp=receive --pose POSE
scan_stamps_zero --scan LASER:bot_core,stamp=receive --pose POSE
EOT
says no_return_29.995m 0 "that is how the sensor says no return"
says scan_stamps_in_ms 0 "its time stamps seem to be milliseconds"
says scan_stamps_zero 0 "its time stamps do not count"

# build names the unit as well, and no offset between clocks.
log_of scan_stamps_in_ms
splinemap build "$log" unit.splinemap --scan LASER --pose POSE > out 2>&1 || true
grep -q "Its stamps seem to be milliseconds" out || fail "no unit: $(cat out)"
if grep -q "time_offset_ms" out; then fail "an offset: $(cat out)"; fi

# What says nothing is no map.
for name in ranges_in_mm hall_120m pitch_20deg two_pose_frames; do
  log_of "$name"
  rm -f none.splinemap
  expect 1 splinemap build "$log" none.splinemap
  [[ ! -e none.splinemap ]] || fail "$name: a map of nothing"
done
says ranges_in_mm 1 "they seem to be millimetres"
says pitch_20deg 1 "120 of its 120 poses tilt the robot by more than 10 degrees"
says two_pose_frames 1 "do two localisations publish on it?"
says hall_120m 0 "100 % of its readings lie beyond range_max_m (30 m)"
proposes hall_120m "--scan LASER:bot_core,range_max_m=84 --pose POSE"

# What cannot be mended is said.
log_of utm_float_poses
expect 0 splinemap build "$log" map.splinemap --force
expect_text "steps of 0.25 m" err
says utm_float_poses 0 "steps of 0.25 m"
log_of raw_laser_and_odom
grep -q "the poses are the robot's odometry" import.txt || fail "raw_laser_and_odom: $(cat import.txt)"
expect 0 splinemap build "$log" map.splinemap --force

# A worse pose channel is said by build as by doctor, and the flags of both in a close call.
lcm=$shared_data/lcm
expect 0 splinemap build "$lcm/sweep_square.lcmlog" map.splinemap --force --pose TRUE_POSE
expect_text "TRUE_POSE: the map is sharper with the poses of SLAM_POSE" err
expect_text "See splinemap doctor $lcm/sweep_square.lcmlog" err
expect 0 splinemap build "$lcm/sweep_square.lcmlog" map.splinemap --force --pose SLAM_POSE
! grep -q "sharper with the poses" err || fail "sweep_square: $(cat err)"
expect 0 splinemap doctor "$lcm/odometry_square.lcmlog"
expect_text "map it with: --scan LIDAR --pose ODOMETRY" out
expect_text "or compare: --scan LIDAR:michigan_2017,time_offset_ms=" out

# What the given flags do not map has no cells "as given".
log_of hall_120m
expect 0 splinemap doctor "$log"
grep -qE '^LASER +POSE +[0-9]+ +- +[0-9]+ ' out || fail "hall_120m: $(cat out)"
