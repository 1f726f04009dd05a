#!/usr/bin/env bash
# Installs the packages in a clean Debian 12 of its own, and runs the tutorials, the daemon from its
# unit and a program that links the libraries there.
set -euo pipefail

usage() {
  cat << EOF
usage: sudo tests/clean_debian.sh [--yes]

Builds the packages, makes a clean Debian 12 in build/clean (debootstrap), installs them with apt,
boots its systemd in namespaces of its own, and runs there what the documents say. Where systemd
cannot be booted, the tutorials are run without it, and that is said. Some minutes.
EOF
}

top=$(cd "$(dirname "$0")/.." && pwd -P)
case ${1:-} in
  "" | --yes) ;;
  -h | --help) usage; exit 0 ;;
  *) usage >&2; exit 2 ;;
esac
((EUID == 0)) || { echo "clean_debian: it needs root: sudo $0" >&2; exit 2; }
# shellcheck source=deploy/packages.sh
source "$top/deploy/packages.sh"
# shellcheck source=deploy/time_taken.sh
source "$top/deploy/time_taken.sh"
say() { echo "clean_debian: $*"; }
fail() { echo "FAILED: $*" >&2; exit 1; }

install_packages yes "${CLEAN_PACKAGES[@]}"
"$top/deploy/package.sh" "$@"

clean=$top/build/clean
root=$clean/root
cgroup=$(findmnt --noheadings --output TARGET --types cgroup2 | head -n 1)/splinemap-clean-$$
booted=
clean_up() {
  if [[ -n $booted ]]; then kill -KILL "$booted" 2> /dev/null || true; wait "$booted" 2> /dev/null || true; fi
  for _ in {1..20}; do  # until its processes are gone
    [[ -d $cgroup ]] || return 0
    find "$cgroup" -depth -type d -exec rmdir {} + 2> /dev/null || sleep 0.2
  done
}
trap clean_up EXIT

rm -rf "$root"
mkdir -p "$clean"
say "debootstrap .."
debootstrap --variant=minbase --include=ca-certificates bookworm "$root" \
  > "$clean/debootstrap.log" || fail "see $clean/debootstrap.log"
cp /etc/resolv.conf "$root/etc/"
printf '#!/bin/sh\nexit 101\n' > "$root/usr/sbin/policy-rc.d"  # nothing is started in a chroot
chmod +x "$root/usr/sbin/policy-rc.d"
mkdir "$root/packages" "$root/splinemap" "$root/checks"
cp "$top"/build/packages/*.deb "$root/packages/"

# apt PACKAGE..: in the clean Debian.
apt() {
  chroot "$root" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "$@" \
    >> "$clean/apt.log" 2>&1 || { tail "$clean/apt.log" >&2; fail "apt-get install $*"; }
}
: > "$clean/apt.log"
chroot "$root" apt-get update -qq
mapfile -t debs < <(cd "$root" && printf '/%s\n' packages/*.deb)
apt "${debs[@]}"
chroot "$root" getent passwd splinemap > /dev/null || fail "there is no user splinemap"
for command in splinemapd splinemap splinemap-viewer splinemap-spy; do
  chroot "$root" "$command" --help > /dev/null || fail "$command does not run"
  [[ $command == splinemap-spy || -e $root/usr/share/man/man1/$command.1.gz ]] || fail "no man page of $command"
done
# shellcheck disable=SC2016  # ${Package} is dpkg-query's
say "the packages are installed: $(chroot "$root" dpkg-query --show --showformat='${Package} ${Version}, ' \
  'splinemap*' 'libsplinemap*')"
# What the tutorials use beside splinemap, and what boots.
apt systemd systemd-sysv dbus man-db bash-completion procps sudo lsb-base \
  liblcm-bin "${DEMO_PACKAGES[@]}" python3 curl cmake ninja-build g++ pkg-config
rm "$root/usr/sbin/policy-rc.d"
tar -C "$top" -c --exclude=./build --exclude=./.git --exclude=node_modules . | tar -x -C "$root/splinemap"

# boot: systemd of the clean Debian as the first process of namespaces of its own, with a loopback
# interface alone.
boot() {
  mkdir "$cgroup"
  (
    echo "$BASHPID" > "$cgroup/cgroup.procs"
    # shellcheck disable=SC2016  # of the inner shell
    exec unshare --mount --pid --net --uts --ipc --cgroup --fork --kill-child=SIGKILL bash -ec '
      cd "$0"
      mount --make-rprivate /
      mount --bind . .
      cd "$0"
      mount -t proc proc proc
      mount -t sysfs -o ro sysfs sys
      mount -t tmpfs tmpfs sys/fs/cgroup 2> /dev/null || true
      mount -t cgroup2 cgroup2 sys/fs/cgroup
      mount -t tmpfs tmpfs run
      mount -t tmpfs tmpfs dev
      for device in null zero full random urandom tty; do
        touch dev/$device
        mount --bind /dev/$device dev/$device
      done
      mkdir dev/pts dev/shm
      mount -t devpts -o newinstance,ptmxmode=0666 devpts dev/pts
      mount -t tmpfs tmpfs dev/shm
      ln -s pts/ptmx dev/ptmx
      ln -s /proc/self/fd dev/fd
      hostname localhost
      ip link set lo up
      ip route add 224.0.0.0/4 dev lo
      mkdir -p old
      pivot_root . old
      cd /
      umount -l old
      exec env -i container=splinemap PATH=/usr/sbin:/usr/bin:/sbin:/bin /lib/systemd/systemd' "$root"
  ) > "$clean/boot.log" 2>&1 < /dev/null &
  booted=$!
  for _ in {1..100}; do
    first=$(pgrep -P "$booted" || true)
    [[ -z $first ]] || ! inside systemctl is-system-running 2> /dev/null | grep -qE 'running|degraded' ||
      return 0
    sleep 0.2
  done
  return 1
}
inside() { nsenter --target "$first" --all env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root "$@"; }

if boot; then
  say "systemd $(inside systemctl --version | head -n 1 | cut -d ' ' -f 2) runs"
  with_systemd=yes
else
  say "systemd cannot be booted here (see $clean/boot.log); the daemon is run by hand"
  with_systemd=no
  inside() { chroot "$root" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root "$@"; }
  mount -t proc proc "$root/proc"
  mount --bind /dev "$root/dev"
  trap 'umount "$root/proc" "$root/dev"; clean_up' EXIT
fi

begin=$SECONDS
inside bash -c 'cd /checks && /splinemap/tests/integration/readme.sh /splinemap' > "$clean/readme.log" 2>&1 ||
  { tail -n 5 "$clean/readme.log" >&2; fail "the commands of the documents; see $clean/readme.log"; }
say "$(grep -E '[0-9]+ commands ran' "$clean/readme.log"), $((SECONDS - begin)) s"
for flags in "" --two-robots; do
  inside bash -c "cd /checks && /splinemap/deploy/demo.sh --installed $flags" > "$clean/demo.log" 2>&1 ||
    { tail -n 5 "$clean/demo.log" >&2; fail "the demo $flags; see $clean/demo.log"; }
  say "demo.sh --installed $flags: $(grep -E '^The map|^Sent' "$clean/demo.log" | head -n 1)"
done
# shellcheck disable=SC2016  # of the inner shell
inside bash -ec 'cmake -G Ninja -S /splinemap/tests/consumer -B /checks/consumer -DCMAKE_BUILD_TYPE=Release
  cmake --build /checks/consumer
  c++ /splinemap/tests/consumer/ask.cc -o /checks/ask $(pkg-config --cflags --libs splinemap)' \
  > "$clean/consumer.log" 2>&1 || { tail -n 20 "$clean/consumer.log" >&2; fail "the consumer"; }
say "a program that links the libraries is built, with CMake and with pkg-config"

[[ $with_systemd == yes ]] || { print_time_taken tests/clean_debian.sh; exit 0; }
cp "$top/tests/integration/unit.sh" "$root/checks/"
inside bash /checks/unit.sh /splinemap || fail "the unit"
print_time_taken tests/clean_debian.sh
