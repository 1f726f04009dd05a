#!/usr/bin/env bash
# Runs fuzz targets under libFuzzer with sanitizers.
set -euo pipefail

usage() {
  cat << HELP
usage: tests/fuzz/run.sh [--yes] [--fast] [--runs N] [TARGET..]

  tests/fuzz/run.sh                                  every target, 1,000,000 runs each
  tests/fuzz/run.sh --fast --runs 10000000 map_file  one target for long; without the address
                                                     sanitizer, which takes half of the time there

Begins with tests/data/fuzz/TARGET and what earlier runs found, which is kept in
build/fuzz-corpus/TARGET. An input that fails is kept in build/fuzz-findings. Installs missing packages
with apt-get (asks first on a terminal, unless --yes).
HELP
}

cd "$(dirname "$0")/../.."
assume_yes=no
runs=1000000
preset=fuzz
while (($#)); do
  case $1 in
    --yes) assume_yes=yes; shift ;;
    --fast) preset=fuzz-fast; shift ;;
    --runs) runs=${2:-}; shift $(($# > 1 ? 2 : 1)) ;;
    -h | --help) usage; exit 0 ;;
    -*) usage >&2; exit 2 ;;
    *) break ;;
  esac
done
[[ $runs =~ ^[0-9]+$ ]] || { usage >&2; exit 2; }
if (($# == 0)); then
  mapfile -t targets < <(ls tests/data/fuzz)
  set -- "${targets[@]}"
fi
for target in "$@"; do
  [[ -d tests/data/fuzz/$target ]] ||
    { echo "no target $target; there are: $(ls -x -w 1000 tests/data/fuzz)" >&2; exit 2; }
done

# shellcheck source=deploy/packages.sh
source deploy/packages.sh
install_packages "$assume_yes" "${BUILD_PACKAGES[@]}" "${TEST_PACKAGES[@]}" "${FUZZ_PACKAGES[@]}"
[[ -f build/$preset/build.ninja ]] || cmake --preset "$preset"
cmake --build --preset "$preset" --target "${@/#/fuzz_}"

# Where one byte makes much work, short inputs find more.
flags_of() {
  case $1 in
    mapper | survey) echo -max_len=256 -entropic=0 ;;
    map_records) echo -max_len=512 -entropic=0 ;;
    map_file) echo -max_len=4096 -entropic=0 ;;
    *) echo -max_len=2048 ;;
  esac
}

for target in "$@"; do
  read -ra flags < <(flags_of "$target")
  found=build/fuzz-corpus/$target
  mkdir -p "$found" build/fuzz-findings
  echo "$target: $runs runs"
  if ! "build/$preset/tests/fuzz/fuzz_$target" -runs="$runs" "${flags[@]}" -rss_limit_mb=1024 \
    -timeout=20 -artifact_prefix="build/fuzz-findings/$target-" \
    "$found" "tests/data/fuzz/$target" > "$found.log" 2>&1; then
    tail -n 40 "$found.log" >&2
    echo "$target: failed; the whole log is $found.log" >&2
    exit 1
  fi
  tail -n 1 "$found.log"
done
