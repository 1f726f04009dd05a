#!/usr/bin/env bash
# A whole fleet on this computer: servers, workers, simulated robots and the viewer.
set -euo pipefail
PATH=$PATH:/usr/sbin  # where nats-server is

usage() {
  cat << 'END'
usage: deploy/fleet/up.sh [--yes] [--installed] [--seconds N] [--port PORT]

Starts three NATS servers (TLS, three copies of everything), two workers, five simulated robots that
drive for some minutes, each with a daemon and an uplink on an LCM bus of its own, and the viewer,
and says where its page is. Goes on until Ctrl-C, which ends all of it.

  --yes          installs missing packages without asking
  --installed    takes the programs on the PATH, and writes into the folder fleet-demo here, in
                 place of build/fleet-demo
  --seconds N    ends after so long
  --port PORT    of the first server (default 14222); the others have the next two
END
}

here=$(cd "$(dirname "$(readlink -f "$0")")" && pwd -P)
top=$(cd "$here/../.." && pwd -P)
out=$top/build/fleet-demo

say() { printf '%s\n' "$*" >&2; }
die() { say "up: $*"; exit 1; }

build() {
  # shellcheck source=deploy/packages.sh
  source "$top/deploy/packages.sh"
  install_packages "$1" "${BUILD_PACKAGES[@]}" "${DEMO_PACKAGES[@]}" "${FLEET_PACKAGES[@]}"
  say "Building, if need be (the first time takes some minutes) .."
  (cd "$top" && cmake --preset release && cmake --build --preset release) > "$out/build.log" 2>&1 ||
    { grep -i error "$out/build.log" | head -5 >&2; die "the build failed; see $out/build.log"; }
  local folder
  for folder in clients/splinemap services/{splinemapd,viewer,fleet_worker,uplink}; do
    PATH=$top/build/release/$folder:$PATH
  done
}

# start NAME COMMAND..: in the background, with what it says in NAME.log.
names=() ids=()
start() {
  local name=$1
  shift
  "$@" > "$out/$name.log" 2>&1 &
  names+=("$name")
  ids+=($!)
}
in_folder() { cd "$1" && shift && exec "$@"; }
on_bus() { LCM_DEFAULT_URL=$1 exec "${@:2}"; }

# In the order against that of the start: robots send their last changes to servers that are there.
end_what_was_started() {
  local k
  for ((k = ${#ids[@]} - 1; k >= 0; --k)); do
    kill "${ids[k]}" 2> /dev/null || continue
    [[ ${names[k]} == drive-* || ${names[k]} == viewer ]] || wait "${ids[k]}" 2> /dev/null || true
  done
  wait 2> /dev/null || true
}

# Names of what has ended, but for drives, which do.
check_running() {
  local k
  for k in "${!ids[@]}"; do
    kill -0 "${ids[k]}" 2> /dev/null || [[ ${names[k]} == drive-* ]] ||
      die "${names[k]} ended: $(tail -n 3 "$out/${names[k]}.log")"
  done
}

# The others go on: to see that, end one of them.
say_what_ended() {
  local k
  for k in "${!ids[@]}"; do
    if [[ ${told[k]:-} || ${names[k]} == drive-* ]] || kill -0 "${ids[k]}" 2> /dev/null; then
      continue
    fi
    say "${names[k]} ended, the others go on; the last that it said: $(
      tail -n 1 "$out/${names[k]}.log")"
    told[k]=yes
    status=1
  done
}

# await WHAT COMMAND..: until it succeeds, at most 30 s.
await() {
  local what=$1
  shift
  for _ in {1..150}; do
    if "$@" 2> /dev/null; then return 0; fi
    check_running
    sleep 0.2
  done
  die "$what after 30 s; see $out"
}

# Whether a server has found the others, and a leader of them.
is_healthy() {
  (
    exec 3<> "/dev/tcp/127.0.0.1/$1"
    printf 'GET /healthz HTTP/1.0\r\n\r\n' >&3
    grep -q '"ok"' <&3
  )
}

servers() {
  local k port peers
  for k in 1 2 3; do
    "$here/credentials.sh" server "$fleet" "server-$k" localhost 127.0.0.1
  done
  for k in 1 2 3; do
    port=$((first_port + k - 1))
    peers=()
    for other in "${ports[@]}"; do
      ((other == port)) || peers+=(--peer "localhost:$other")
    done
    "$here/server.sh" "$fleet" "server-$k" --port "$port" "${peers[@]}"
    start "server-$k" in_folder "$fleet/servers/server-$k" nats-server -c server.conf
  done
  for port in "${ports[@]}"; do
    await "a server is not ready" is_healthy $((port + 4000))
  done
}

workers() {
  local k
  for k in 1 2; do
    start "worker-$k" splinemap-fleet-worker "${as_fleet[@]}" --credentials "$fleet/worker-$k" \
      --replicas 3
  done
}

# Each robot drives through a fifth of the office, there and back, three times.
simulate() {
  splinemap simulate "$out/office.lcmlog" --world-out "$out/office.world" --force
  local k
  for k in 1 2 3 4 5; do
    awk -v from=$((7 * k - 6)) -v to=$((7 * k < 35 ? 7 * k + 1 : 35)) '
      /^waypoint/ { ++n; inside = 1 }
      inside { waypoint[n] = waypoint[n] $0 "\n"; if (/^}/) inside = 0; next }
      { print }
      END {
        for (round = 0; round < 3; ++round) {
          for (k = from; k <= to; ++k) printf "%s", waypoint[k]
          for (k = to - 1; k > from; --k) printf "%s", waypoint[k]
        }
      }' "$out/office.world" > "$out/robot-$k.world"
    splinemap simulate "$out/robot-$k.world" "$out/robot-$k.lcmlog" --seed "$k" --force
  done
}

robots() {
  local k bus
  for k in 1 2 3 4 5; do
    # A UDP port of its own, which does not leave this computer.
    bus="udpm://239.255.76.67:$((first_port + 5000 + k))?ttl=0&recv_buf_size=2000000"
    start "robot-$k" on_bus "$bus" splinemapd --map "$out/robot-$k.splinemap" --name "robot-$k" \
      --scan LASER --pose POSE
    start "uplink-$k" splinemap-uplink --robot "robot-$k" --lcm-url "$bus" "${as_fleet[@]}" \
      --credentials "$fleet/robot-$k" --max-kb-per-s 100 --map "$out/robot-$k.splinemap"
  done
  sleep 1  # daemons that miss the beginning of the drive miss little
  for k in 1 2 3 4 5; do
    bus="udpm://239.255.76.67:$((first_port + 5000 + k))?ttl=0&recv_buf_size=2000000"
    start "drive-$k" lcm-logplayer --lcm-url="$bus" "$out/robot-$k.lcmlog"
  done
}

viewer() {
  local port=8086
  ! (exec 3<> "/dev/tcp/127.0.0.1/$port") 2> /dev/null || port=0  # somebody has it
  start viewer splinemap-viewer "${as_fleet[@]}" --credentials "$fleet/viewer" --port "$port"
  await "the viewer says nothing" grep -q . "$out/viewer.log"
  say "$(head -n 1 "$out/viewer.log")"
}

assume_yes=no installed=no seconds='' first_port=14222
while (($#)); do
  case $1 in
    -h | --help) usage; exit 0 ;;
    --yes) assume_yes=yes ;;
    --installed) installed=yes ;;
    --seconds) seconds=${2:-}; shift ;;
    --port) first_port=${2:-}; shift ;;
    *) usage >&2; exit 2 ;;
  esac
  shift || { usage >&2; exit 2; }
done
[[ $seconds =~ ^([1-9][0-9]{0,6})?$ ]] || die "--seconds wants a number"
[[ $first_port =~ ^[1-9][0-9]{3,4}$ ]] || die "--port wants a number"
((first_port < 60000)) || die "--port has to be below 60000"

[[ $installed == no ]] || out=$PWD/fleet-demo
mkdir -p "$out"
exec 9> "$out/lock"
flock --nonblock 9 || die "another one is running in $out"
[[ $installed == yes ]] || build "$assume_yes"
for program in nats-server openssl lcm-logplayer splinemap{,d,-viewer,-uplink,-fleet-worker}; do
  command -v "$program" > /dev/null || die "$program is not there"
done
ip route get 239.255.76.67 > /dev/null 2>&1 ||
  die "there is no route for LCM: sudo ip route add 224.0.0.0/4 dev lo"

# All anew, but for the lock.
find "$out" -mindepth 1 -maxdepth 1 -not -name lock -not -name build.log -exec rm -r {} +
trap end_what_was_started EXIT
trap 'exit 0' INT TERM
fleet=$out/credentials
ports=("$first_port" $((first_port + 1)) $((first_port + 2)))
urls=$(printf ',tls://localhost:%s' "${ports[@]}")
urls=${urls#,}
as_fleet=(--fleet "$urls" --fleet-map map)
{
  "$here/credentials.sh" new "$fleet"
  for k in 1 2; do "$here/credentials.sh" worker "$fleet" "worker-$k"; done
  for k in 1 2 3 4 5; do "$here/credentials.sh" robot "$fleet" "robot-$k"; done
  "$here/credentials.sh" viewer "$fleet" viewer
  "$here/credentials.sh" operator "$fleet" operator
  simulate
} > "$out/made.log" 2>&1 || die "$(tail -n 3 "$out/made.log")"
say "Starting three servers, two workers and five robots; what they say is in $out/*.log .."
servers >> "$out/made.log"
workers
robots
viewer
say "The fleet, for commands: --fleet $urls --credentials $fleet/operator"
end=$((SECONDS + ${seconds:-1000000000}))
told=() status=0
while ((SECONDS < end)); do
  say_what_ended
  sleep 1 &
  wait $! || true  # so that Ctrl-C is heard at once
done
((status == 0))
