#!/usr/bin/env bash
# Makes the credentials of a fleet, and the list of users that its NATS servers take them by.
set -euo pipefail

usage() {
  cat << 'END'
usage: credentials.sh new FOLDER                       a fleet: its certificate authority
       credentials.sh server FOLDER NAME HOST..        a NATS server, called by these hosts
       credentials.sh robot|viewer|operator|worker FOLDER NAME
       credentials.sh renew FOLDER NAME                the same, valid for longer
       credentials.sh remove FOLDER NAME               they are refused from now on
       credentials.sh list FOLDER                      who there is, and until when

  credentials.sh new fleet
  credentials.sh server fleet node-1 node-1.example.org 192.0.2.1
  credentials.sh robot fleet robot-1 --days 90
  credentials.sh viewer fleet desk

  --days N    how long they are valid (server: 3650, others: 365; the authority: 7300)

A credential is a folder, FOLDER/NAME, with ca.pem, own.pem and own.key; of a server it is
FOLDER/servers/NAME. Copy it to where it is used, and own.key nowhere else. A robot writes the
layers of its own name alone, an operator all layers and their settings, a worker everything, a
viewer nothing. All read, and ask workers.

FOLDER/users.conf says so to the servers. It is copied to FOLDER/servers/*: bring it from there to
each server, and have it read again: nats-server --signal reload=PID. Keep FOLDER/ca.key secret:
who has it makes credentials.
END
}

die() { echo "credentials: $*" >&2; exit 1; }

# A name as a token of a key: TokenOf() in lib/fleet/fleet_key.h.
token_of() {
  local LC_ALL=C name=$1 token='' c k
  for ((k = 0; k < ${#name}; ++k)); do
    c=${name:k:1}
    if [[ $c == [a-zA-Z0-9_-] ]]; then
      token+=$c
    else
      printf -v c '=%02x' "'$c"
      token+=${c/=ffffffffffffff/=}  # printf takes bytes beyond 127 for negative
    fi
  done
  echo "$token"
}

# FOLDER/users has lines of role, token of the name, number of the credential.
role_of() { awk -v token="$1" '$2 == token { print $1 }' "$folder/users"; }

# The folder of a credential.
place_of() {  # ROLE TOKEN
  if [[ $1 == server ]]; then echo "$folder/servers/$2"; else echo "$folder/$2"; fi
}

# Runs openssl, and says what it says only where that fails.
quietly() {
  local said
  said=$(openssl "$@" 2>&1) || die "openssl $1 failed: $said"
}

# A file appears whole, or not at all.
replace() {
  local file=$1 mode=$2 new
  new=$(mktemp "$file.XXXXXX")
  cat > "$new"
  chmod "$mode" "$new"
  mv "$new" "$file"
}

new() {
  [[ ! -e $folder ]] || die "$folder is there already"
  mkdir -p "$folder/servers"
  chmod 700 "$folder"
  quietly req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days "$days" \
    -subj "/O=splinemap fleet/CN=$(openssl rand -hex 8)" \
    -addext "basicConstraints=critical,CA:TRUE,pathlen:0" -addext "keyUsage=critical,keyCertSign" \
    -keyout "$folder/ca.key" -out "$folder/ca.pem"
  chmod 600 "$folder/ca.key"
  openssl rand -hex 32 | replace "$folder/servers.password" 600
  : > "$folder/users"
  write_users
  echo "made $folder: add servers to it, then workers and robots"
}

# sign PLACE: makes the certificate that own.csr there asks for.
sign() {
  quietly x509 -req -in "$1/own.csr" -copy_extensions copy -CA "$folder/ca.pem" \
    -CAkey "$folder/ca.key" -days "$days" -set_serial "0x$(openssl rand -hex 16)" \
    -out "$1/own.pem.new"
  mv "$1/own.pem.new" "$1/own.pem"
}

# add ROLE NAME EXTENSION..: the folder of a credential.
add() {
  local role=$1 token number place
  token=$(token_of "$2")
  ((${#token} >= 1 && ${#token} <= 64)) || die "a name has 1 to 64 letters, not '$2'"
  [[ $token != servers ]] || die "'servers' is the folder of the servers: give another name"
  [[ -z $(role_of "$token") ]] ||
    die "$2 is there already, as a $(role_of "$token"): renew it, or remove it first"
  number=$(openssl rand -hex 8)
  place=$(place_of "$role" "$token")
  rm -rf "$place"  # what was not finished
  mkdir -p "$place"
  chmod 700 "$place"
  local extension extensions=(-addext "basicConstraints=critical,CA:FALSE"
    -addext "keyUsage=critical,digitalSignature")
  for extension in "${@:3}"; do extensions+=(-addext "$extension"); done
  quietly req -new -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes "${extensions[@]}" \
    -subj "/OU=$number/CN=$token" -keyout "$place/own.key" -out "$place/own.csr"
  chmod 600 "$place/own.key"
  sign "$place"
  cp "$folder/ca.pem" "$place/"
  echo "$role $token $number" >> "$folder/users"
  write_users
  echo "made $place, valid for $days days"
}

server() {
  local name=$1 host alternatives=()
  shift
  for host in "$@"; do
    if [[ $host =~ ^[0-9.]+$ || $host == *:* ]]; then
      alternatives+=("IP:$host")
    else
      [[ $host =~ ^[a-zA-Z0-9.-]+$ ]] || die "$host is no name of a host"
      alternatives+=("DNS:$host")
    fi
  done
  add server "$name" "extendedKeyUsage=serverAuth,clientAuth" \
    "subjectAltName=$(IFS=,; echo "${alternatives[*]}")"
}

# Its key, its name and what it is for stay.
renew() {
  local token role place
  token=$(token_of "$1")
  role=$(role_of "$token")
  [[ -n $role ]] || die "$folder has no $1"
  place=$(place_of "$role" "$token")
  sign "$place"
  echo "renewed $place/own.pem, valid for $days days: copy it to where it is used"
}

remove() {
  local token role place
  token=$(token_of "$1")
  role=$(role_of "$token")
  [[ -n $role ]] || die "$folder has no $1"
  place=$(place_of "$role" "$token")
  awk -v token="$token" '$2 != token' "$folder/users" | replace "$folder/users" 600
  rm -rf "$place"
  write_users
  echo "removed $1: it is refused as soon as all servers have read users.conf again"
}

list() {
  local role token number place
  while read -r role token number; do
    place=$(place_of "$role" "$token")
    printf '%-9s %-20s until %s\n' "$role" "$token" \
      "$(openssl x509 -in "$place/own.pem" -noout -enddate 2> /dev/null | sed 's/.*=//')"
  done < "$folder/users"
}

# What all do: look up entries and lists of them, follow what is stored, and ask.
# shellcheck disable=SC2016  # the servers' subjects
readers_publish='"$JS.API.INFO", "$JS.API.STREAM.INFO.*", "$JS.API.STREAM.MSG.GET.*",
  "$JS.API.CONSUMER.CREATE.*", "$JS.API.CONSUMER.INFO.*.*", "$JS.API.CONSUMER.DELETE.*.*",
  "$JS.FC.>", "splinemap.*.ask.>"'

# The users of the servers. Their names are the subjects of the certificates. Each gets answers on
# inboxes of its own, which the store calls after the certificate.
write_users() {
  local role token number place publish subscribe
  {
    echo "# Made by credentials.sh: who may do what. Each name is the subject of a certificate."
    echo "users = ["
    while read -r role token number; do
      subscribe="\"_INBOX.$token.>\", \"splinemap.*.stored.>\", \"splinemap.*.workers\""
      case $role in
        robot) publish="\"\$KV.*.layers.$token.>\", $readers_publish" ;;
        viewer) publish=$readers_publish ;;
        operator) publish="\"\$KV.*.layers.>\", \"\$KV.*.settings.>\", $readers_publish" ;;
        worker)
          # shellcheck disable=SC2016
          publish='"$KV.>", "$JS.API.>", "$JS.FC.>", "splinemap.>", "_INBOX.>"'
          subscribe="\"_INBOX.$token.>\", \"splinemap.>\""
          ;;
        *) continue ;;  # servers are no users
      esac
      printf '{ user: "CN=%s,OU=%s"  # %s\n' "$token" "$number" "$role"
      printf '  permissions: { publish: { allow: [%s] }\n' "$publish"
      printf '    subscribe: { allow: [%s] } } }\n' "$subscribe"
    done < "$folder/users"
    echo "]"
  } | replace "$folder/users.conf" 644
  for place in "$folder"/servers/*/; do
    [[ ! -d $place ]] || replace "${place}users.conf" 644 < "$folder/users.conf"
  done
}

days=''
arguments=()
while (($#)); do
  case $1 in
    -h | --help) usage; exit 0 ;;
    --days) days=${2:-}; shift; [[ $days =~ ^[1-9][0-9]{0,4}$ ]] || die "--days wants a number" ;;
    -*) usage >&2; exit 2 ;;
    *) arguments+=("$1") ;;
  esac
  shift
done
set -- "${arguments[@]}"
command=${1:-} folder=${2:-}
case $command/$# in
  new/2 | list/2 | robot/3 | viewer/3 | operator/3 | worker/3 | renew/3 | remove/3) ;;
  server/*) (($# >= 4)) || { usage >&2; exit 2; } ;;
  *) usage >&2; exit 2 ;;
esac
[[ $command == new || -f $folder/users ]] ||
  die "$folder is no fleet: make it with credentials.sh new"
umask 077
case $command in
  new) days=${days:-7300} ;;
  server) days=${days:-3650} ;;
  *) days=${days:-365} ;;
esac
case $command in
  new) new ;;
  robot | viewer | operator | worker) add "$command" "$3" "extendedKeyUsage=clientAuth" ;;
  server) server "${@:3}" ;;
  renew | remove) "$command" "$3" ;;
  list) list ;;
esac
