# shellcheck shell=bash disable=SC2034  # the lists are for those who source this
# Debian packages that splinemap needs. Sourced by demo.sh, package.sh and tests/run.sh.

BUILD_PACKAGES=(
  g++ cmake ninja-build ccache pkg-config
  liblcm-dev liblcm-bin libglib2.0-dev libeigen3-dev libprotobuf-dev protobuf-compiler libzstd-dev
  libabsl-dev libfmt-dev libspdlog-dev libcli11-dev libsqlite3-dev libsqlitecpp-dev libxxhash-dev libsodium-dev
  libpng-dev libtiff-dev zlib1g-dev nlohmann-json3-dev libyaml-cpp-dev
  esbuild libboost-dev libssl-dev prometheus-cpp-dev libsystemd-dev libnats-dev
)
DEMO_PACKAGES=(jq iproute2)
FLEET_PACKAGES=(nats-server openssl)
TEST_PACKAGES=(
  libgtest-dev jq iproute2 nftables sqlite3 python3 libompl-dev curl
  default-jdk liblcm-java libjchart2d-java libxmlgraphics-commons-java libjide-oss-java
  xvfb xdotool chromium nodejs openssl strace faketime nats-server
)
# Node.js of others than Debian brings npm along, and conflicts with the package.
command -v npm > /dev/null || TEST_PACKAGES+=(npm)
PACKAGE_PACKAGES=(debhelper fakeroot help2man lintian default-jdk-headless liblcm-java)
CLEAN_PACKAGES=(debootstrap util-linux procps iproute2)
ARM_PACKAGES=(g++-aarch64-linux-gnu qemu-user)
FUZZ_PACKAGES=(clang libclang-rt-14-dev)
BENCH_PACKAGES=(
  libbenchmark-dev libmrpt-maps-dev liboctomap-dev libdynamicedt3d-dev libopencv-imgproc-dev libopencv-stitching-dev
  python3 python3-matplotlib
)

# install_packages ASSUME_YES PACKAGE..: says which are missing and installs them. With ASSUME_YES=no
# it asks on a terminal first.
install_packages() {
  local assume_yes=$1 package missing=() as_root=()
  shift
  if ! command -v dpkg-query > /dev/null; then
    echo "This is no Debian or Ubuntu; make sure that the equivalents are there of: $*" >&2
    return 0
  fi
  for package in "$@"; do
    # shellcheck disable=SC2016  # ${Status} is dpkg-query's
    [[ $(dpkg-query -W -f '${Status}' "$package" 2> /dev/null) == *" installed" ]] ||
      missing+=("$package")
  done
  ((${#missing[@]})) || return 0
  echo "Missing packages: ${missing[*]}" >&2
  if [[ $assume_yes != yes && -t 0 ]]; then
    read -r -p "Install them with apt-get? [Y/n] " answer
    [[ -z $answer || $answer == [yY]* ]] || { echo "Nothing was installed." >&2; return 1; }
  fi
  ((EUID == 0)) || as_root=(sudo)
  if ! { "${as_root[@]}" apt-get update -qq &&
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
      apt-get install -y -qq --no-install-recommends "${missing[@]}" > /dev/null; }; then
    echo "apt-get failed. Try: ${as_root[*]} apt-get install ${missing[*]}" >&2
    return 1
  fi
  # Debian starts one that takes anybody from anywhere.
  if [[ " ${missing[*]} " == *" nats-server "* ]] && command -v systemctl > /dev/null; then
    "${as_root[@]}" systemctl disable --now nats-server > /dev/null 2>&1 || true
  fi
}
