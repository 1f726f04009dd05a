#!/usr/bin/env bash
# Programs of somebody else against the installed package: with CMake, with pkg-config, and with the
# project as a part of theirs. They follow and ask a real daemon.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

build=$(dirname "$(dirname "$(dirname "$(command -v splinemap)")")")
cmake --install "$build" --prefix "$PWD/installed" > install.log 2>&1 || fail "$(tail install.log)"
for file in bin/splinemapd bin/splinemap include/splinemap/replica.h include/splinemap/client.h \
  include/splinemap/map.h include/splinemap/query.h include/splinemap/file.h \
  include/splinemap/scan.h include/lcmtypes/splinemap/status_t.hpp \
  share/splinemap/lcmtypes/splinemap/status_t.lcm \
  share/doc/splinemap/examples/splinemapd.textproto; do
  [[ -f installed/$file ]] || fail "not installed: $file"
done
! grep -rqE '#include "(lib|lcmtypes)/' installed/include/splinemap ||
  fail "$(grep -rE '#include "(lib|lcmtypes)/' installed/include/splinemap)"

cmake -G Ninja -S "$top/tests/consumer" -B consumer -DCMAKE_PREFIX_PATH="$PWD/installed" \
  -DCMAKE_BUILD_TYPE=Release > consumer.log 2>&1 || fail "$(tail -n 20 consumer.log)"
cmake --build consumer > consumer.log 2>&1 || fail "$(tail -n 20 consumer.log)"

PKG_CONFIG_PATH=$(dirname "$(find installed -name splinemap.pc)")
export PKG_CONFIG_PATH
# shellcheck disable=SC2046  # several words
c++ "$top/tests/consumer/ask.cc" -o ask_with_pkg_config $(pkg-config --cflags --libs splinemap) \
  > pkg_config.log 2>&1 || fail "$(tail -n 20 pkg_config.log)"

# The README's example.
awk '/^```cpp/ { inside = 1; next } /^```/ { inside = 0 } inside' "$top/README.md" > example
{ grep '^#include' example; echo 'int main() {'; grep -v '^#include' example; echo '}'; } > example.cc
# shellcheck disable=SC2046
c++ -fsyntax-only example.cc $(pkg-config --cflags splinemap) > example.log 2>&1 ||
  fail "$(tail -n 20 example.log)"

# As a part of another project, that configures: no programs, no tests, none of their packages.
cmake -G Ninja -S "$top/tests/consumer" -B part -DSPLINEMAP_SOURCE="$top" > part.log 2>&1 ||
  fail "$(tail -n 20 part.log)"
targets=$(ninja -C part -t targets all)
[[ $targets == *libsplinemap_replica.a* ]] || fail "the part has no replica"
[[ $targets != *splinemapd:* && $targets != *unit_tests* ]] || fail "the part has programs or tests"

splinemap simulate drive.lcmlog 2> /dev/null
splinemapd --map robot.splinemap --name robot --scan LASER --pose POSE 2> daemon.log &
daemon=$!
await splinemap watch --once --timeout 2
lcm-logplayer -s 20 drive.lcmlog > /dev/null
consumer/follow kept.splinemap > out 2> err || fail "follow: $(cat err)"
expect_text "tiles; at the origin known, log-odds" out
splinemap info kept.splinemap > out || fail "the kept map: $(cat out)"
for ask in consumer/ask ./ask_with_pkg_config; do
  $ask > out 2> err || fail "$ask: $(cat err)"
  expect_text "asked robot" out
  [[ $(grep -c ' m$' out) == 4 ]] || fail "$ask: $(cat out)"
done
kill "$daemon"
wait "$daemon" || fail "the daemon: $(cat daemon.log)"
echo "consumer: $(cat out)"
