#!/usr/bin/env bash
# lcm-spy with splinemap's types. Debian's own lcm-spy does not start on Debian's Java 17.
set -euo pipefail

usage() {
  cat << 'EOT'
usage: deploy/lcm-spy.sh [--lcm-url=URL]    (splinemap-spy, where splinemap is installed)

Opens lcm-spy, which then shows the types of splinemap, bot_core and Michigan, and those of your own
jars: CLASSPATH=my_types.jar deploy/lcm-spy.sh
Where a jar of yours has a type as well, yours is shown. A double click on SPLINEMAP_SCANS or
SPLINEMAP_DIGESTS opens the map in your browser, the page of a splinemap-viewer that runs beside the
bus; their fields are on the menu of the right button. The page is http://localhost:8086/, or
another: SPLINEMAP_VIEWER=https://base:8086/?token=0123 deploy/lcm-spy.sh
EOT
}

die() { printf 'lcm-spy: %s\n' "$*" >&2; exit 1; }

case ${1:-} in
  "" | --lcm-url=*) ;;
  -h | --help) usage; exit 0 ;;
  *) usage >&2; exit 2 ;;
esac

java_jars=/usr/share/java
libraries=
missing=()
while read -r jar package; do
  libraries+=${libraries:+:}$java_jars/$jar
  [[ -e $java_jars/$jar ]] || missing+=("$package")
done << 'EOT'
jchart2d.jar libjchart2d-java
xmlgraphics-commons.jar libxmlgraphics-commons-java
jide-oss.jar libjide-oss-java
EOT
[[ -e $java_jars/lcm.jar ]] || missing+=(liblcm-java)
java=$(readlink -f "$(command -v java)" || true)
[[ -e ${java%/bin/java}/lib/libawt_xawt.so ]] || missing+=(default-jre)  # a headless Java opens no window

# Installed beside this script, or in the build folder of the checkout.
here=$(dirname "$(readlink -f "$0")")
types=
for path in "$here"/../share/java "$here"/../build/{release,dev}/lcmtypes; do
  [[ -n $types || ! -e $path/splinemap-types.jar ]] || types=$path/splinemap-types.jar
done
[[ -n $types ]] || command -v javac > /dev/null || missing+=(default-jdk-headless)

((${#missing[@]} == 0)) || die "packages are missing; install them: sudo apt-get install ${missing[*]}"
[[ -n $types ]] ||
  die "splinemap-types.jar is not built; build it: cmake --preset release && cmake --build --preset release"
[[ -n ${DISPLAY:-} ]] || die "there is no display to open a window on (DISPLAY is not set)"

# lcm-spy looks for types in the environment's CLASSPATH and then in -cp, and of several classes for
# one type it shows the last; of classes of one name Java takes that of -cp. So the user's jars go
# there. The libraries are no place to look.
[[ -z ${1:-} ]] || export LCM_DEFAULT_URL=${1#--lcm-url=}
exec env CLASSPATH="$types:${types%-types.jar}-spy.jar" java -Djava.net.preferIPv4Stack=true \
  -Xbootclasspath/a:"$libraries" -cp "$java_jars/lcm.jar${CLASSPATH:+:$CLASSPATH}" lcm.spy.Spy
