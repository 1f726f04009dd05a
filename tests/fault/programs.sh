#!/usr/bin/env bash
# programs.sh [--seconds N] [--seed N] [--quick]: faults of the real programs, on a bus of their own: kills
# of commands while they write, and of a daemon and a base station that follows it while they map a drive
# at high speed; syncs that fail, a slow disk, a clock that steps by years, processes that are stopped, a
# memory limit. Prints what was tried and what was lost; README.md explains it. --quick: the first three.
if [[ -z ${LCM_DEFAULT_URL:-} || ${1:-} != inside ]]; then
  top=$(cd "$(dirname "$(readlink -f "$0")")/../.." && pwd -P)
  dev=$top/build/dev
  command -v splinemapd > /dev/null ||
    export PATH=$dev/clients/splinemap:$dev/services/splinemapd:$dev/tests:$PATH
  exec "$top/deploy/own_bus.sh" "$0" inside "$top" "$@"
fi
arguments=("${@:3}")
# shellcheck source=tests/integration/support.sh
source "$2/tests/integration/support.sh" "$2"

seconds=300
quick=
RANDOM=1
set -- "${arguments[@]}"
while (($#)); do
  case $1 in
    --seconds) seconds=$2; shift ;;
    --seed) RANDOM=$2; shift ;;
    --quick) seconds=10 quick=yes ;;
    *) fail "unknown option $1" ;;
  esac
  shift
done

complaints=0
complain() { echo "NOT AS IT SHOULD BE: $*"; complaints=$((complaints + 1)); }
row() { printf '%-44s %8s %10s   %s\n' "$@"; }
skip() { row "$1" - - "skipped: $2"; }
# random FROM TO: ms.
random_ms() { echo $(($1 + (RANDOM * 32768 + RANDOM) % ($2 - $1 + 1))); }
pause_ms() { sleep "$(($1 / 1000)).$(printf %03d $(($1 % 1000)))"; }
now_ms() { date +%s%3N; }
commits() { splinemap info "$1" --json | jq '[.layers[].commits] | max // 0'; }

splinemap simulate drive.lcmlog 2> /dev/null
splinemap simulate short.lcmlog --rate 1 --pose-rate 20 --seed 2 2> /dev/null

# --- commands that are killed while they write
splinemap build short.lcmlog a.splinemap 2> /dev/null
splinemap build short.lcmlog b.splinemap 2> /dev/null
splinemap trajectory a.splinemap | awk -F, -v OFS=, 'NR > 1 && NF == 4 { $2 += 0.5 } 1' > moved.csv
declare -A command=(
  [build]="build short.lcmlog"
  [merge]="merge a.splinemap b.splinemap --out"
  [correct]="correct a.splinemap moved.csv --out"
  [fold]="fold a.splinemap --knot-interval-m 0.1 --out"
  [backup]="backup a.splinemap"
  [flatten]="flatten a.splinemap"
)
kill_commands() {
  local name took end tried survived delay out=out.splinemap words
  for name in "${!command[@]}"; do
    read -ra words <<< "${command[$name]}"
    took=$(now_ms)
    splinemap "${words[@]}" whole.splinemap --force > /dev/null 2>&1 || complain "$name: fails"
    took=$(($(now_ms) - took))
    tried=0 survived=0
    end=$((SECONDS + $1 / ${#command[@]} + 1))
    while ((SECONDS < end)); do
      rm -f "$out"
      ((RANDOM % 2)) || cp b.splinemap "$out"
      delay=$(random_ms 1 $((took + 20)))
      splinemap "${words[@]}" "$out" --force > /dev/null 2>&1 &
      pause_ms "$delay"
      kill -KILL $! 2> /dev/null || true
      wait $! 2> /dev/null || true
      tried=$((tried + 1))
      # Nothing, the old file, or the new one: of a build, one that its scans make.
      if [[ ! -e $out ]] || cmp -s b.splinemap "$out" || splinemap diff whole.splinemap "$out" ||
        { [[ $name == build ]] && splinemap verify "$out"; }; then
        survived=$((survived + 1))
      fi > /dev/null 2>&1
    done
    row "kill: splinemap $name" "$tried" "$survived" "nothing"
    ((tried == survived)) || complain "splinemap $name"
    splinemap "${words[@]}" "$out" --force > /dev/null 2>&1
    ! compgen -G "$out.*" > /dev/null || complain "$name leaves files: $(ls "$out".*)"
  done
}

# --- a daemon, and a base station that follows it
cat > daemon.textproto << 'END'
scan { channel: "LASER" } pose: "POSE" service { save_interval_s: 1 }
END
start_robot() {
  "$@" splinemapd --config daemon.textproto --name robot --map robot.splinemap 2>> robot.log &
  robot=$!
}
start_base() {
  splinemapd --no-sensors --name base --map base.splinemap 2>> base.log &
  base=$!
}
last_written_ms() {  # FILE
  stat -c %.3Y "$1" "$1-wal" 2> /dev/null | sort -n | tail -n 1 | tr -d .
}
end() { kill "$1" && wait "$1"; }

kill_daemons() {
  local end=$((SECONDS + $1)) tried=0 survived=0 tried_base=0 survived_base=0 stops=0 most_ms=0
  local killed_ms saved lost_ms found
  start_base
  start_watching
  start_drive drive.lcmlog 10
  while ((SECONDS < end)); do
    start_robot
    pause_ms "$(random_ms 300 2500)"
    if ((RANDOM % 4 == 0)); then
      kill -STOP "$robot"
      pause_ms "$(random_ms 10 500)"
      kill -CONT "$robot"
      stops=$((stops + 1))
      pause_ms "$(random_ms 0 300)"
    fi
    saved=$(status_of robot .saved_revision)
    kill -KILL "$robot"
    killed_ms=$(now_ms)
    { wait "$robot" || true; } 2> /dev/null
    tried=$((tried + 1))
    [[ -e robot.splinemap ]] || { survived=$((survived + 1)); continue; }  # it had not begun
    lost_ms=$((killed_ms - $(last_written_ms robot.splinemap)))
    ((lost_ms <= most_ms)) || most_ms=$lost_ms
    found=$(commits robot.splinemap 2> /dev/null || echo -1)
    if ((tried % 10)) || splinemap verify robot.splinemap > verify.out 2>&1; then
      if ((found >= saved)); then survived=$((survived + 1)); else
        complain "the file has $found commits, and $saved were on disk"; fi
    else
      complain "after a kill: $(cat verify.out)"
    fi
    if ((tried % 5 == 0)); then
      kill -KILL "$base"
      wait "$base" 2> /dev/null || true
      tried_base=$((tried_base + 1))
      if splinemap info base.splinemap > info.out 2>&1; then
        survived_base=$((survived_base + 1))
      else
        complain "the base station's file: $(cat info.out)"
      fi
      start_base
    fi
  done
  start_robot
  sleep 3
  end_drive
  sleep 6  # pulls
  end "$robot" || complain "the daemon: $(tail -n 3 robot.log)"
  end "$base" || complain "the base station: $(tail -n 3 base.log)"
  end_watching
  row "kill: daemon that maps" "$tried" "$survived" "$((most_ms / 1000)).$(printf %03d $((most_ms % 1000))) s since the last save, most"
  row "kill: base station that follows" "$tried_base" "$survived_base" "nothing: it is sent again"
  row "stop and go on (SIGSTOP)" "$stops" "$stops" "nothing"
  splinemap verify robot.splinemap > verify.out || complain "$(cat verify.out)"
  splinemap diff robot.splinemap base.splinemap > diff.out ||
    complain "the follower has not the same map: $(cat diff.out)"
}

# maps WHAT: the robot that runs goes on mapping.
maps() {
  local before
  before=$(status_of robot .scans_mapped)
  sleep 3
  (($(status_of robot .scans_mapped) > before)) || complain "$1: it does not map on"
}
begin_single() {
  rm -f robot.splinemap* base.splinemap* robot.log
  : > robot.log
  start_watching
  start_drive drive.lcmlog 5
}
end_single() {  # STATUS
  local status=0
  end_drive
  { end "$robot" || status=$?; } 2> /dev/null
  end_watching
  [[ $1 == any ]] || ((status == $1)) || complain "status $status: $(tail -n 3 robot.log)"
  splinemap verify robot.splinemap > verify.out 2>&1 || complain "$(cat verify.out)"
}
# said TEXT: the robot's log has it, soon.
said() {
  for _ in {1..300}; do
    if grep -qF -- "$1" robot.log; then return; fi
    sleep 0.2
  done
  complain "no '$1' in: $(cat robot.log)"
}

fail_syncs() {
  local injected=(strace -D -f -qq -o /dev/null -e "trace=fsync,fdatasync" -e)
  if ! strace -qq -o /dev/null -e trace=fsync true 2> /dev/null; then
    skip "failing and slow syncs" "strace is missing, or may not trace"
    return
  fi
  begin_single
  start_robot "${injected[@]}" inject=fsync,fdatasync:error=EIO:when=14
  said "it is written anew"
  end_single 0
  row "a sync fails" 1 1 "nothing"
  [[ -z $quick ]] || return 0

  begin_single
  start_robot "${injected[@]}" inject=fsync,fdatasync:error=EIO:when=14+
  said "the map is not saved"
  maps "all syncs fail"
  end_single 1
  said "commits to the map are lost"
  row "all syncs fail from an instant on" 1 1 "all since then; told, exit status 1"

  begin_single
  start_robot "${injected[@]}" inject=fsync,fdatasync:delay_exit=300000
  sleep 8
  maps "a slow disk"
  [[ $(status_of robot '.problems | length') == 0 ]] || complain "a slow disk: $(status_of robot .problems)"
  end_single 0
  row "slow disk: 0.3 s for each sync" 1 1 "nothing"
}

step_clock() {
  local library step
  library=$(find /usr/lib -name libfaketimeMT.so.1 2> /dev/null | head -n 1)
  [[ -n $library ]] || { skip "clock that steps by years" "the package faketime is missing"; return; }
  begin_single
  echo "+0" > clock
  start_robot env LD_PRELOAD="$library" FAKETIME_TIMESTAMP_FILE="$PWD/clock" FAKETIME_NO_CACHE=1 \
    FAKETIME_DONT_FAKE_MONOTONIC=1
  sleep 3
  for step in +10y -10y +1y +0; do
    echo "$step" > clock
    maps "the clock steps to $step"
  done
  end_single 0
  said "clock"
  row "clock steps by years" 4 4 "nothing"
}

limit_memory() {
  local kb
  begin_single
  start_robot
  sleep 3
  kb=$(awk '/VmData/ { print $2 }' "/proc/$robot/status")
  prlimit --pid "$robot" --data=$((kb * 1024))
  sleep 6
  local how="it goes on"
  kill -0 "$robot" 2> /dev/null || how="ended by the system"
  end_single any
  row "memory limit of what it has already" 1 1 "$how; all to the last save is there"
}

row kind tried survived "lost at most"
kill_commands $((seconds * 35 / 100))
kill_daemons $((seconds * 45 / 100))
fail_syncs
if [[ -z $quick ]]; then
  step_clock
  limit_memory
fi
((complaints == 0)) || fail "$complaints complaints"
echo "programs: nothing was lost that was on the disk"
