#!/usr/bin/env bash
# What the daemon and doctor --live say while a drive is played to them with wrong flags.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

splinemap simulate drive.lcmlog 2> /dev/null

# start NAME FLAG..: a daemon whose map, log and status channel have that name.
start() {
  local name=$1
  shift
  printf 'channel_prefix: "%s"\n' "$name" > "$name.textproto"
  splinemapd --config "$name.textproto" --map "$name.splinemap" --name robot "$@" 2> "$name.log" &
  await splinemap watch --prefix "$name" --once --timeout 2
}
start RIGHT --scan LASER --pose POSE
start SIGN --scan LASER:bot_core,bearing_sign=-1 --pose POSE
start CLOCK --scan LASER:bot_core,time_offset_ms=-3600000 --pose POSE
start NAME --scan LASERS --pose POSE
start TYPE --scan POSE --pose LASER

splinemap doctor --live --seconds 12 --json > live.json 2> live.err &
live=$!
lcm-logplayer -s 10 drive.lcmlog > player.log 2>&1 &
player=$!

# says NAME TEXT: the log of that daemon has the text, or will have.
says() { await grep -qF -- "$2" "$1.log"; }
says SIGN "Try --scan LASER:bot_core"
says CLOCK "before the poses of POSE"
says CLOCK "time_offset_ms=0"
says NAME "nothing was received on LASERS for 5 s"
says TYPE "which is bot_core.pose_t"
says TYPE "which is bot_core.planar_lidar_t"
splinemap watch --prefix SIGN --once --json > status.json
[[ $(jq '.problems.options_disagree > 0 and (.last_problem | contains("sharper"))' status.json) == true ]] ||
  fail "problems: $(cat status.json)"
# What is said of every scan is said once a minute.
(($(grep -c "which is bot_core.pose_t" TYPE.log) == 1)) || fail "said again: $(cat TYPE.log)"
! grep -E 'warning|error' RIGHT.log || fail "a complaint without reason"

wait "$live" || fail "doctor --live: $(cat live.err)"
[[ $(jq -c .chosen_flags live.json) == '["--scan","LASER","--pose","POSE"]' ]] ||
  fail "doctor --live: $(cat live.json)"
kill "$player" 2> /dev/null || true  # it may be at its end
echo "diagnosis: all is well"
