#!/usr/bin/env bash
# Maps a drive, from lcm-logplayer over LCM into splinemapd, and shows the map.
set -euo pipefail

usage() {
  cat << EOF
usage: deploy/demo.sh [--yes] [--installed] [--no-viewer] [LOG [input flags of splinemapd]]
       deploy/demo.sh [--yes] [--installed] [--no-viewer] --two-robots [LOG_A LOG_B]

  deploy/demo.sh                                     a simulated drive through an office floor
  deploy/demo.sh drive.lcmlog                        an LCM log
  deploy/demo.sh intel.log.gz                        a CARMEN log
  deploy/demo.sh lab.lcmlog --pose SLAM_POSE --scan LIDAR:michigan_2017,time_offset_ms=-200
  deploy/demo.sh --two-robots                        two simulated robots, each with a daemon
  deploy/demo.sh --two-robots one.lcmlog two.lcmlog  two logs of one place, in one frame

Installs what is missing (asks first on a terminal, unless --yes), builds, plays the log on a bus of
its own that no robot hears, and writes build/demo/map.png and build/demo/demo.splinemap. On a
terminal it shows the map in your browser meanwhile, and goes on until Ctrl-C, unless --no-viewer.
Two robots follow each other: their sum is map.png, and in each of their files. --installed takes the
programs on the PATH instead, and writes into the folder demo here. splinemapd --help lists input
flags.
EOF
}

top=$(cd "$(dirname "$(readlink -f "$0")")/.." && pwd -P)
# Both are set by main, for what it starts.
out=${SPLINEMAP_DEMO:-$top/build/demo}
viewer=${SPLINEMAP_DEMO_VIEWER:-no}

say() { printf '%s\n' "$*" >&2; }
die() { say "demo: $*"; exit 1; }

build() {
  say "Building, if need be (the first time takes some minutes) .."
  local log=$out/build.log
  cd "$top"
  cmake --preset release > "$log" 2>&1 || { tail -n 5 "$log" >&2; die "cmake failed; see $log"; }
  if [[ -t 2 ]]; then
    cmake --build --preset release >&2 || die "the build failed"  # ninja shows its progress
  else
    cmake --build --preset release >> "$log" 2>&1 ||
      { grep -iE "error" "$log" | head -5 >&2; die "the build failed; see $log"; }
  fi
  cd - > /dev/null
}

# Leaves the drive, a simulated one for an empty LOG, as an LCM log, and prints its path.
prepare_log() {
  local log=$1 name=$2
  if [[ -z $log ]]; then
    splinemap simulate "$out/office.lcmlog" --force
    echo "$out/office.lcmlog"
  elif [[ $(head -c 4 -- "$log" | od -An -tx1 | tr -d ' \n') == eda1da01 ]]; then
    realpath "$log"
  else
    splinemap import-carmen "$log" "$out/$name.lcmlog" --force ||
      die "$log is neither an LCM log nor a CARMEN log"
    echo "$out/$name.lcmlog"
  fi
}

# Halves of the simulated drive, which meet at a waypoint.
simulate_two() {
  splinemap simulate "$out/office.lcmlog" --world-out "$out/office.world" --force 2> /dev/null
  local meet=18 k
  awk -v n=$meet '/^waypoint/ { k++ } k <= n' "$out/office.world" > "$out/robot-1.world"
  awk -v n=$meet '/^waypoint/ { k++ } k == 0 || k >= n' "$out/office.world" > "$out/robot-2.world"
  for k in 1 2; do
    splinemap simulate "$out/robot-$k.world" "$out/drive-$k.lcmlog" --seed $k --force
  done
}

# Says in $out/NAME.json what doctor finds in a log.
inspect() {
  local log=$1 json=$out/$2.json
  shift 2
  splinemap doctor "$log" --json "$@" > "$json" ||
    [[ -s $json ]] || exit 1  # a log that is damaged is played as far as it goes
  [[ $(jq -r .problem "$json") == null ]] || die "$(jq -r .problem "$json")"
}

# A speed at which a log that was inspected takes about 20 s, and at most 1,000 messages come a
# second.
choose_speed() {
  jq -r '([.channels[].messages] | add) as $messages
    | ([20, $messages / 1000] | max) as $seconds
    | [1, .duration_s / $seconds] | max' "$out/$1.json"
}

# A field of the daemon's newest status, 0 where there is none yet.
newest() {
  local value
  value=$(tail -n 1 "$out/status.jsonl" 2> /dev/null | jq -r "$1" 2> /dev/null)
  echo "${value:-0}"
}

show_progress() {
  local scans=$1
  [[ -t 2 ]] || return 0
  printf '\r  %s of %s scans received, %s mapped, %s tiles \e[K' "$(newest .scans_received)" \
    "$scans" "$(newest .scans_mapped)" "$(newest .tiles)" >&2
}

# By id: jobs in the background do not get Ctrl-C from the terminal.
end_what_was_started() {
  local job
  for job in $(jobs -p); do kill "$job" 2> /dev/null || true; done
}

# Runs a command on the demo's own bus. With the viewer it inherits a socket of this computer, which
# the viewer takes over there, so that the page opens in the user's own browser.
on_own_bus() {
  if [[ $viewer == no ]]; then
    "$top/deploy/own_bus.sh" "$@"
    return
  fi
  # shellcheck disable=SC2016  # Perl's
  perl -MSocket -e '
    $^F = 3;  # inherited, as the third file
    socket(PAGE, PF_INET, SOCK_STREAM, 0) or die "socket: $!";
    setsockopt(PAGE, SOL_SOCKET, SO_REUSEADDR, 1);
    bind(PAGE, sockaddr_in(8086, INADDR_LOOPBACK)) or
      bind(PAGE, sockaddr_in(0, INADDR_LOOPBACK)) or die "bind: $!";
    listen(PAGE, 128) or die "listen: $!";
    exec(@ARGV) or die "$ARGV[0]: $!"' "$top/deploy/own_bus.sh" "$@" 3>&-
}

# Starts the viewer on the socket of on_own_bus, with the flags of a daemon that it understands.
start_viewer() {
  local flags=()
  [[ $viewer == yes ]] || return 0
  while (($#)); do
    case $1 in
      --scan | --pose) flags+=("$1" "${2:-}"); shift ;;
      --scan=* | --pose=*) flags+=("$1") ;;
    esac
    shift
  done
  (LISTEN_FDS=1 LISTEN_PID=$BASHPID exec splinemap-viewer "${flags[@]}") 2> "$out/viewer.log" &
  viewer_id=$!
  exec 3>&-
  for _ in {1..50}; do
    [[ -s $out/viewer.log ]] && break
    sleep 0.1
  done
  say "$(head -n 1 "$out/viewer.log")"
}

# Until Ctrl-C, with the viewer.
serve_page() {
  [[ $viewer == yes ]] || return 0
  trap 'exit 0' INT TERM
  say "$(head -n 1 "$out/viewer.log")"
  wait "$viewer_id" || die "the viewer ended: $(cat "$out/viewer.log")"
}

# What the demo leaves of one robot.
show_map() {
  splinemap render "$out/demo.splinemap"
  splinemap render "$out/demo.splinemap" "$out/map.png" --force 2> /dev/null
  splinemap info "$out/demo.splinemap"
  echo "The map: $out/map.png (and $out/demo.splinemap)"
}

# The part on the demo's own bus: play LOG into a daemon with the remaining arguments as flags.
play() {
  local log=$1 speed=$2 scans=$3 messages=$4
  shift 4
  rm -f "$out"/demo.splinemap* "$out/status.jsonl"
  trap end_what_was_started EXIT
  trap 'exit 130' INT TERM
  start_viewer "$@"
  splinemapd --map "$out/demo.splinemap" "$@" 2> "$out/splinemapd.log" &
  local daemon=$!
  splinemap watch --once --timeout 15 > /dev/null ||
    { cat "$out/splinemapd.log" >&2; die "the daemon did not start"; }
  splinemap watch --json > "$out/status.jsonl" 2> /dev/null &
  local watch=$!

  lcm-logplayer -s "$speed" "$log" > "$out/logplayer.log" 2>&1 &
  local player=$!
  while kill -0 "$player" 2> /dev/null; do
    show_progress "$scans"
    sleep 0.3
  done
  wait "$player" || { cat "$out/logplayer.log" >&2; die "lcm-logplayer failed"; }
  # The last messages are under way; the next status tells.
  for _ in {1..20}; do
    (($(newest .messages_received) >= messages)) && break
    sleep 0.3
  done
  show_progress "$scans"
  if [[ -t 2 ]]; then printf '\n' >&2; fi
  if [[ $viewer == yes ]]; then
    splinemap save 2> /dev/null || die "the daemon did not save the map"
  else
    kill "$daemon"
    wait "$daemon" || { cat "$out/splinemapd.log" >&2; die "the daemon failed"; }
  fi
  sleep 0.2  # the daemon's last status
  kill "$watch"
  wait "$watch" 2> /dev/null || true

  grep -E 'warning|error|dropped' "$out/splinemapd.log" | cut -d ' ' -f 3- | sort -u >&2 || true
  local received
  received=$(newest .messages_received)
  say "Sent $messages messages; received $received, mapped $(newest .scans_mapped) of $scans scans."
  ((received == messages)) || die "$((messages - received)) of them were lost on the way"
  show_map
  serve_page
}

# The part of two robots on the demo's own bus: a daemon for each, which follows the other.
play_two() {
  local k daemons=() players=() flags
  rm -f "$out"/robot-?.splinemap*
  trap end_what_was_started EXIT
  trap 'exit 130' INT TERM
  start_viewer
  for k in 1 2; do
    mapfile -t flags < <(jq -r '.chosen_flags[]' "$out/robot-$k.json")
    splinemapd --map "$out/robot-$k.splinemap" --name "robot-$k" --follow 'robot-*' "${flags[@]}" \
      2> "$out/robot-$k.log" &
    daemons+=($!)
  done
  for k in 1 2; do
    splinemap layers --live --robot "robot-$k" --timeout 3 > /dev/null ||
      { cat "$out/robot-$k.log" >&2; die "the daemon of robot-$k did not start"; }
  done
  for k in 1 2; do
    lcm-logplayer -s "$(choose_speed robot-$k)" "$out/robot-$k.lcmlog" > "$out/logplayer.log" 2>&1 &
    players+=($!)
  done
  for k in 1 2; do
    wait "${players[k - 1]}" || { cat "$out/logplayer.log" >&2; die "lcm-logplayer failed"; }
  done
  sleep 3  # the last scans wait for poses, and then travel to the other robot
  splinemap layers --live
  for k in 1 2; do
    splinemap render --live --robot "robot-$k" "$out/robot-$k.png" --force 2> /dev/null
  done
  splinemap render --live "$out/map.png" --force 2> /dev/null
  splinemap render --live
  echo "The map of both: $out/map.png; of each: $out/robot-1.png, $out/robot-2.png"
  serve_page
  for k in 1 2; do
    kill "${daemons[k - 1]}"
    wait "${daemons[k - 1]}" ||
      { cat "$out/robot-$k.log" >&2; die "the daemon of robot-$k failed"; }
    say "robot-$k: $(sed -n 's/.*info \(mapped .*\);.*/\1/p' "$out/robot-$k.log")"
  done
}

two_robots() {
  local logs=("$@") k log
  if ((!$#)); then
    simulate_two
    logs=("$out"/drive-[12].lcmlog)
  fi
  for k in 1 2; do
    log=$(prepare_log "${logs[k - 1]}" "drive-$k")
    splinemap prefix-channels "$log" "robot-${k}_" "$out/robot-$k.lcmlog" --force 2> /dev/null
    inspect "$out/robot-$k.lcmlog" "robot-$k"
  done
  say "Playing both drives into a daemon each .."
  on_own_bus "$0" --play-two
}

one_robot() {
  local log chosen speed scans messages
  log=$(prepare_log "$1" imported)
  shift
  inspect "$log" log "$@"
  mapfile -t chosen < <(jq -r '.chosen_flags[]' "$out/log.json")
  speed=$(choose_speed log)
  scans=$(jq '.scans as $s | [.channels[] | select(.name | IN($s[])) | .messages] | add' \
    "$out/log.json")
  messages=$(jq '(.scans + [.pose]) as $c | [.channels[] | select(.name | IN($c[])) | .messages] | add' \
    "$out/log.json")
  say "Playing $(basename "$log") ($(jq '.duration_s | round' "$out/log.json") s) at speed $(printf %.1f "$speed") into splinemapd .."
  on_own_bus "$0" --play "$log" "$speed" "$scans" "$messages" "$@" "${chosen[@]}"
}

main() {
  local assume_yes=no installed=no no_viewer=no demo=one_robot log='' argument arguments=()
  for argument in "$@"; do
    case $argument in
      --yes) assume_yes=yes ;;
      --installed) installed=yes ;;
      --no-viewer) no_viewer=yes ;;
      --two-robots) demo=two_robots ;;
      *) arguments+=("$argument") ;;
    esac
  done
  set -- "${arguments[@]}"
  [[ ${1:-} != -h && ${1:-} != --help ]] || { usage; exit 0; }
  if [[ ${1:-} == -* ]] || { [[ $demo == two_robots ]] && (($# != 0 && $# != 2)); }; then
    usage >&2
    exit 2
  fi
  for log in "${@:1:$([[ $demo == two_robots ]] && echo 2 || echo 1)}"; do
    [[ -f $log && -r $log ]] || die "cannot read $log"
  done
  [[ $installed == no ]] || out=$PWD/demo
  export SPLINEMAP_DEMO=$out
  mkdir -p "$out"
  exec 9> "$out/lock"
  flock --nonblock 9 || die "another demo is running in $out"
  # shellcheck source=deploy/time_taken.sh
  source "$top/deploy/time_taken.sh"
  if [[ $installed == no ]]; then
    # shellcheck source=deploy/packages.sh
    source "$top/deploy/packages.sh"
    install_packages "$assume_yes" "${BUILD_PACKAGES[@]}" "${DEMO_PACKAGES[@]}"
    build
    PATH=$top/build/release/clients/splinemap:$top/build/release/services/splinemapd:$top/build/release/services/viewer:$PATH
  fi
  if [[ $no_viewer == no && -z ${CI:-} && -t 2 ]] && command -v splinemap-viewer > /dev/null; then
    viewer=yes
  fi
  export SPLINEMAP_DEMO_VIEWER=$viewer
  if [[ $demo == one_robot ]] && (($# == 0)); then set -- ''; fi
  "$demo" "$@"
  [[ $viewer == yes ]] || print_time_taken deploy/demo.sh
}

case ${1:-} in
  --play) shift; play "$@" ;;
  --play-two) play_two ;;
  *) main "$@" ;;
esac
