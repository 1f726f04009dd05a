#!/usr/bin/env bash
# Fetches a nats-server that keeps what it acknowledges.
set -euo pipefail

usage() {
  cat << EOF
usage: deploy/fleet/newer_server.sh [FOLDER]

  deploy/fleet/newer_server.sh                 into build/nats-server
  sudo apt install ./build/nats-server/*.deb   installs it in place of Debian 12's

Debian 12's nats-server 2.9.10 loses acknowledged writes at times when a server is killed. This
fetches the package of Debian 13 with apt, which checks its signature, and unpacks it; nothing is
installed. The last line is the folder of the program, for PATH.
EOF
}

case ${1:-} in
  -h | --help) usage; exit 0 ;;
  -*) usage >&2; exit 2 ;;
esac
folder=${1:-$(dirname "$0")/../../build/nats-server}
mkdir -p "$folder"
folder=$(realpath "$folder")
programs=$folder/usr/sbin
if [[ -x $programs/nats-server ]]; then
  echo "$programs"
  exit 0
fi

# Where this computer's Debian comes from.
# shellcheck disable=SC2016  # apt's variable
archive=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 2> /dev/null |
  grep -m 1 '/debian/*$' || true)
keys=/usr/share/keyrings/debian-archive-keyring.gpg
if [[ -z $archive || ! -f $keys ]]; then
  echo "newer_server.sh: apt has no Debian archive here, or $keys is not there" >&2
  exit 1
fi
state=$(mktemp -d)
trap 'rm -rf "$state"' EXIT
mkdir -p "$state"/{lists,cache/archives}/partial
echo "deb [signed-by=$keys] $archive trixie main" > "$state/sources.list"
options=(-qq -o "Dir::Etc::SourceList=$state/sources.list" -o Dir::Etc::SourceParts=/dev/null
  -o "Dir::State::Lists=$state/lists" -o "Dir::Cache=$state/cache"
  -o "APT::Sandbox::User=$(id -un)")
if ! apt-get "${options[@]}" update ||
  ! (cd "$folder" && apt-get "${options[@]}" download nats-server); then
  echo "newer_server.sh: nats-server of Debian 13 cannot be fetched" >&2
  exit 1
fi
dpkg-deb --extract "$folder"/nats-server_*.deb "$folder"
"$programs/nats-server" --version >&2
echo "$programs"
