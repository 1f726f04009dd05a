#!/usr/bin/env bash
# Installs what the tests need, builds, runs every test, ends with ctest's summary.
set -euo pipefail

usage() {
  cat << EOF
usage: tests/run.sh [--yes] [PRESET [ctest arguments]]

  tests/run.sh                  every test, those of units under sanitizers
  tests/run.sh dev              every test without sanitizers
  tests/run.sh asan             unit tests under address and undefined-behaviour sanitizers
  tests/run.sh tsan             the tests with threads under thread sanitizer
  tests/run.sh dev -R Queue     the tests of a name

Installs missing packages with apt-get (asks first on a terminal, unless --yes).
EOF
}

cd "$(dirname "$0")/.."
assume_yes=no
[[ ${1:-} != --yes ]] || { assume_yes=yes; shift; }
case ${1:-} in
  "" | dev | asan | tsan) ;;
  -h | --help) usage; exit 0 ;;
  *) usage >&2; exit 2 ;;
esac

# shellcheck source=deploy/packages.sh
source deploy/packages.sh
# shellcheck source=deploy/time_taken.sh
source deploy/time_taken.sh
install_packages "$assume_yes" "${BUILD_PACKAGES[@]}" "${TEST_PACKAGES[@]}"
deploy/fleet/newer_server.sh > /dev/null ||
  echo "The fleet is tested with the nats-server that is installed." >&2

configure() {
  [[ -f build/$1/build.ninja ]] || cmake --preset "$1"
}

# test_with PRESET ctest-arguments..
test_with() {
  ctest --preset "$1" --parallel "$(nproc)" --progress "${@:2}"
}

# run PRESET ctest-arguments..
run() {
  configure "$1"
  cmake --build --preset "$1"
  test_with "$@"
}

# All unit tests in a few processes: to start one for each test takes longer than the tests. What
# runs beside has the processors first.
run_sanitized_tests() {
  renice -n 19 "$BASHPID" > /dev/null
  local shards shard programs=(build/asan/tests/unit_tests build/asan/tests/decode_test) jobs=()
  shards=$(nproc)
  for program in "${programs[@]}"; do
    for ((shard = 0; shard < shards; ++shard)); do
      GTEST_TOTAL_SHARDS=$shards GTEST_SHARD_INDEX=$shard "$program" --gtest_brief=1 &
      jobs+=($!)
    done
    for job in "${jobs[@]}"; do wait "$job"; done
    jobs=()
  done
  test_with asan -L fuzz
}

preset=${1:-}
(($#)) && shift
case $preset in
  dev) run dev "$@" ;;
  asan) run asan -L unit "$@" ;;
  tsan)
    threaded='DaemonTest|MailboxTest|MapViewTest|RequestServerTest|CommandTest|WorkBesideTest'
    run tsan -R "^($threaded|ReceivingThreadTest|ReplayPropertyTest.MappingBeside|asking)" "$@"
    ;;
  "")
    configure asan
    cmake --build --preset asan
    configure dev
    cmake --build build/dev
    # Tests of programs mostly wait for something.
    run_sanitized_tests > build/sanitized_tests.log 2>&1 &
    sanitized=$!
    failed=no
    ctest --preset dev --parallel $((2 * $(nproc))) --progress -L integration || failed=yes
    echo "unit tests and fuzz corpora under sanitizers, which ran beside:"
    wait "$sanitized" || failed=yes
    cat build/sanitized_tests.log
    [[ $failed == no ]]
    ;;
esac
print_time_taken tests/run.sh
