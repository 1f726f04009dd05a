#!/usr/bin/env bash
# Builds the Debian packages of splinemap into build/packages, and checks them with lintian.
set -euo pipefail

usage() {
  cat << EOF
usage: deploy/package.sh [--yes]

Builds splinemapd, splinemap-tools, splinemap-viewer, splinemap-fleet and libsplinemap-dev for the
Debian that it runs on, and fails where lintian finds an error. Install them with
sudo apt-get install build/packages/*.deb
Installs missing packages with apt-get (asks first on a terminal, unless --yes).
EOF
}

cd "$(dirname "$0")/.."
assume_yes=no
case ${1:-} in
  "") ;;
  --yes) assume_yes=yes ;;
  -h | --help) usage; exit 0 ;;
  *) usage >&2; exit 2 ;;
esac

# shellcheck source=deploy/packages.sh
source deploy/packages.sh
# shellcheck source=deploy/time_taken.sh
source deploy/time_taken.sh
install_packages "$assume_yes" "${BUILD_PACKAGES[@]}" "${PACKAGE_PACKAGES[@]}"

# Debian's tools build in a folder with debian/ at its top. Object files of before stay.
out=build/packages
source=$out/source
mkdir -p "$source"
find "$source" -mindepth 1 -maxdepth 1 -not -name build -exec rm -r {} +
tar -c --exclude=./build --exclude=./.git --exclude=./tests --exclude=node_modules . |
  tar -x -C "$source"
cp -r deploy/debian "$source/debian"
rm -f "$out"/*.{deb,changes,buildinfo}
build_depends=$(printf '%s, ' "${BUILD_PACKAGES[@]}" help2man default-jdk-headless liblcm-java)
sed "s/@BUILD_PACKAGES@/${build_depends%, }/" deploy/debian/control.in > "$source/debian/control"
version=$(sed -n 's/^project(splinemap VERSION \([0-9.]*\).*/\1/p' CMakeLists.txt)
cat > "$source/debian/changelog" << EOF
splinemap ($version) unstable; urgency=medium

  * Built from the sources of $version; deploy/CHANGELOG.md says what changed.

 -- $(sed -n 's/^Maintainer: //p' deploy/debian/control.in)  $(date -R)
EOF

(cd "$source" && DEB_BUILD_OPTIONS="noautodbgsym parallel=$(nproc)" \
  dpkg-buildpackage --build=binary --no-sign --no-pre-clean) > "$out/build.log" 2>&1 ||
  { tail -n 30 "$out/build.log" >&2; echo "package: the build failed; see $out/build.log" >&2; exit 1; }
lintian --fail-on error --suppress-tags bad-distribution-in-changes-file "$out"/*.changes
ls -sh "$out"/*.deb
print_time_taken deploy/package.sh
