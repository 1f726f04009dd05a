#!/usr/bin/env bash
# day.sh [--hours N] [--speed N] [--quick]: a day of driving (24 h of message time), at 20 times its speed,
# into a daemon that is restarted 20 times, every other time after a kill, and to a base station that is
# not. Samples memory, open files, the size of the map file and the time that a scan takes. Fails where the
# last third of the day has more of one than the third before, or where the base station ends with another
# map. 75 minutes by hand; --quick: an hour of driving in 3 minutes.
#
# The drive is a simulated one, again and again; so its map stops growing after the first third, and its
# archive at the limit that is set here.
if [[ -z ${LCM_DEFAULT_URL:-} || ${1:-} != inside ]]; then
  top=$(cd "$(dirname "$(readlink -f "$0")")/../.." && pwd -P)
  dev=$top/build/dev
  command -v splinemapd > /dev/null ||
    export PATH=$dev/clients/splinemap:$dev/services/splinemapd:$PATH
  exec "$top/deploy/own_bus.sh" "$0" inside "$top" "$@"
fi
arguments=("${@:3}")
# shellcheck source=tests/integration/support.sh
source "$2/tests/integration/support.sh" "$2"

hours=24
speed=20
set -- "${arguments[@]}"
while (($#)); do
  case $1 in
    --hours) hours=$2; shift ;;
    --speed) speed=$2; shift ;;
    --quick) hours=1 ;;
    *) fail "unknown option $1" ;;
  esac
  shift
done
duration_s=$(jq -n "$hours * 3600 / $speed | floor")
restarts=20  # about

cat > daemon.textproto << 'END'
scan { channel: "LASER" } pose: "POSE" service { save_interval_s: 1 max_archive_mb: 2 }
END
start_robot() {
  splinemapd --config daemon.textproto --name robot --map robot.splinemap 2>> robot.log &
  robot=$!
}
splinemap simulate drive.lcmlog 2> /dev/null
splinemapd --no-sensors --name base --map base.splinemap 2> base.log &
base=$!
start_robot
start_watching
start_drive drive.lcmlog "$speed"

resident_kb() { awk '/VmRSS/ { print $2 }' "/proc/$1/status"; }
open_files() { find "/proc/$1/fd" -mindepth 1 2> /dev/null | wc -l; }
kb_of() { du -c --apparent-size -k "$1"* | tail -n 1 | cut -f 1; }

names=(robot_kB base_kB robot_files base_files robot_map_kB base_map_kB scan_ms)
printf '%8s' s; printf '%14s' "${names[@]}"; echo
begun=$SECONDS
started=$begun
while ((SECONDS < begun + duration_s)); do
  sleep $((duration_s / 60 > 1 ? duration_s / 60 : 1))
  # What has just been started has not all yet.
  if ((SECONDS - started >= duration_s / restarts / 2)); then
    printf '%8d %13d %13d %13d %13d %13d %13d %13.3f\n' $((SECONDS - begun)) \
      "$(resident_kb "$robot")" "$(resident_kb "$base")" "$(open_files "$robot")" \
      "$(open_files "$base")" "$(kb_of robot.splinemap)" "$(kb_of base.splinemap)" "$(status_of robot '.scan_time_mean_ms // 0')" |
      tee -a samples
  fi
  if ((SECONDS - started >= duration_s / restarts)); then
    started=$SECONDS
    restarted=$((${restarted:-0} + 1))
    if ((restart_kills = !${restart_kills:-0})); then
      kill -KILL "$robot"
      { wait "$robot" || true; } 2> /dev/null
      splinemap info robot.splinemap > info || fail "after a kill: $(cat info)"
    else
      kill "$robot"
      wait "$robot" || fail "the daemon: $(tail -n 3 robot.log)"
    fi
    start_robot
  fi
done
end_drive
sleep 6  # until followers have pulled what they lack
for program in "$robot" "$base"; do
  kill "$program"
  wait "$program" || fail "a daemon: $(tail -n 3 robot.log base.log)"
done
end_watching
splinemap verify robot.splinemap
expect 0 splinemap diff robot.splinemap base.splinemap

# The greatest of the last third, beside that of the third before: a tenth more is noise. Of times, the
# least, since others use the processors too.
awk -v names="${names[*]}" -v from="$duration_s" '
  {
    part = int(3 * $1 / from)
    if (part > 2) part = 2
    for (k = 2; k <= NF; ++k) {
      if (!((part, k) in kept)) kept[part, k] = $k
      if (k == NF ? $k < kept[part, k] : $k > kept[part, k]) kept[part, k] = $k
    }
  }
  END {
    split(names, name, " ")
    for (k = 2; k <= NF; ++k) {
      before = kept[1, k]
      if (!((1, k) in kept && (2, k) in kept)) { print "no samples of " name[k - 1]; exit 1 }
      allowed = before + (name[k - 1] ~ /files/ ? 2 : k == NF ? before + 1 : 0.1 * before + 2000)
      printf "%-14s %10.1f -> %10.1f\n", name[k - 1], before, kept[2, k]
      if (kept[2, k] > allowed) { print "GROWS: " name[k - 1]; grows = 1 }
    }
    exit grows
  }' samples || fail "something grows, or too little was seen"
echo "day: $hours h of driving, $restarted restarts: nothing grows, and the base station has the same map"
