#!/usr/bin/env bash
# Cross-compiles for arm64, runs the unit tests in qemu, and compares bytes of maps with this
# processor's.
set -euo pipefail

usage() {
  cat << EOF
usage: tests/arm/run.sh [--yes] [FILTER]

  tests/arm/run.sh                    unit tests but ReplayPropertyTest, and the bytes of maps and
                                      answers
  tests/arm/run.sh 'PointKernel*'     the unit tests of a name, and the bytes

Lays Debian's arm64 packages of libraries into build/arm/sysroot (70 MB to download, 460 MB); the
host's packages stay as they are, but for missing ones, which are installed with apt-get (asks first
on a terminal, unless --yes). Builds all libraries, some four minutes on two cores.
EOF
}

cd "$(dirname "$0")/../.."
assume_yes=no
[[ ${1:-} != --yes ]] || { assume_yes=yes; shift; }
case ${1:-} in
  -h | --help) usage; exit 0 ;;
  -*) usage >&2; exit 2 ;;
esac
(($# <= 1)) || { usage >&2; exit 2; }
filter=${1:--ReplayPropertyTest.*}  # minutes each in qemu
# shellcheck source=deploy/packages.sh
source deploy/packages.sh
# shellcheck source=deploy/time_taken.sh
source deploy/time_taken.sh
say() { echo "arm: $*"; }
fail() { echo "FAILED: $*" >&2; exit 1; }

# shellcheck source=/dev/null
source /etc/os-release
[[ $ID == debian ]] || fail "this needs Debian, for its packages of arm64"
install_packages "$assume_yes" "${BUILD_PACKAGES[@]}" libgtest-dev "${ARM_PACKAGES[@]}"

work=$PWD/build/arm
sysroot=$work/sysroot
build=$work/arm64

# The development packages of the build and what they depend on, unpacked. apt-get has folders of
# its own, where arm64 is the only architecture and nothing is installed.
make_sysroot() {
  local package packages=(libc6-dev libstdc++-12-dev libgtest-dev)
  for package in "${BUILD_PACKAGES[@]}"; do
    [[ $package != *-dev ]] || packages+=("$package")
  done
  [[ $(cat "$sysroot/packages" 2> /dev/null) != "${packages[*]}" ]] || return 0
  say "packages of arm64 .."
  rm -rf "$sysroot" "$work/apt"
  mkdir -p "$sysroot" "$work/apt/lists/partial" "$work/apt/cache/archives/partial"
  : > "$work/apt/status"
  cat > "$work/apt/apt.conf" << EOF
APT::Architecture "arm64";
APT::Architectures { "arm64"; };
APT::Install-Recommends "false";
APT::Sandbox::User "";
Dir::State "$work/apt";
Dir::State::status "$work/apt/status";
Dir::Cache "$work/apt/cache";
Dir::Etc::sourcelist "$work/apt/sources.list";
Dir::Etc::sourceparts "/nonexistent";
EOF
  # Where this computer's Debian comes from.
  local keys=/usr/share/keyrings/debian-archive-keyring.gpg
  # shellcheck disable=SC2016  # apt's variables
  apt-get indextargets --format '$(REPO_URI) $(RELEASE)' 'Created-By: Packages' |
    grep '/debian\(-security\)\?/* ' | sort -u |
    sed "s#.*#deb [signed-by=$keys] & main#" > "$work/apt/sources.list"
  [[ -s $work/apt/sources.list ]] || fail "apt has no Debian archive here"
  APT_CONFIG=$work/apt/apt.conf apt-get update -qq
  APT_CONFIG=$work/apt/apt.conf apt-get install --download-only -qq -y "${packages[@]}" > /dev/null
  for package in "$work"/apt/cache/archives/*.deb; do dpkg -x "$package" "$sysroot"; done
  # Absolute links would lead out of it.
  local link target
  find "$sysroot" -type l -lname '/*' | while read -r link; do
    target=$sysroot$(readlink "$link")
    [[ ! -e $target ]] || ln -sfn --relative "$target" "$link"
  done
  rm -rf "$work/apt"
  echo "${packages[*]}" > "$sysroot/packages"
}

make_sysroot
say "build .."
[[ -f build/dev/build.ninja ]] || cmake --preset dev > /dev/null
[[ -f $build/build.ninja ]] ||
  cmake -S . -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=Release -DCMAKE_UNITY_BUILD=ON \
    -DCMAKE_UNITY_BUILD_BATCH_SIZE=0 -DSPLINEMAP_SYSROOT="$sysroot" \
    --toolchain "$PWD/tests/arm/toolchain.cmake" > "$work/cmake.log"
cmake --build build/dev --target map_bytes > "$work/build.log"
cmake --build "$build" --target map_bytes unit_tests >> "$work/build.log" ||
  { tail "$work/build.log" >&2; fail "see $work/build.log"; }

# Neither the compiler nor Eigen may fuse multiplications and additions.
fused=$(find "$build/lib" -name '*.a' -exec aarch64-linux-gnu-objdump -dC --no-show-raw-insn {} + |
  awk '/>:$/ { name = $0 } /\t(fn?m(add|sub)|fml[as])\t/ { print name }' | sort -u)
[[ -z $fused ]] || fail "fused multiplications in $fused"
say "no fused multiplications"

in_qemu() { qemu-aarch64 -L "$sysroot" "$@"; }

drives=(../shared/data/carmen/{intel,freiburg-079}-corrected.log.gz)
[[ -f ${drives[0]} ]] || drives=()
build/dev/tests/map_bytes "${drives[@]}" > "$work/bytes.here" &
here=$!
in_qemu "$build/tests/map_bytes" "${drives[@]}" > "$work/bytes.arm64"
wait "$here"
diff "$work/bytes.here" "$work/bytes.arm64" || fail "other bytes than here"
say "$(wc -l < "$work/bytes.here") hashes of maps and answers are those of this processor"

shards=$(nproc)
jobs=()
for ((shard = 0; shard < shards; ++shard)); do
  GTEST_TOTAL_SHARDS=$shards GTEST_SHARD_INDEX=$shard \
    in_qemu "$build/tests/unit_tests" --gtest_brief=1 --gtest_filter="$filter" &
  jobs+=($!)
done
for job in "${jobs[@]}"; do wait "$job" || failed=yes; done
[[ -z ${failed:-} ]] || fail "unit tests"
print_time_taken tests/arm/run.sh
