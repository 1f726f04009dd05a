#!/usr/bin/env bash
# Writes the configuration of a NATS server of a fleet, beside its credentials.
set -euo pipefail
PATH=$PATH:/usr/sbin  # where nats-server is

usage() {
  cat << 'END'
usage: server.sh FOLDER NAME [--peer HOST[:PORT]].. [flags]
       server.sh FOLDER NAME --leaf-of HOST[:PORT].. [flags]

  server.sh fleet node-1 --peer node-2.example.org --peer node-3.example.org --address 0.0.0.0
  server.sh fleet site-1 --leaf-of node-1.example.org --leaf-of node-2.example.org

Writes FOLDER/servers/NAME/server.conf, of a server that credentials.sh has made there. Bring the
folder to the server's computer, and start it in there: nats-server -c server.conf. What is stored
lies beside it, in the folder jetstream.

  --peer HOST[:PORT]     another server of the cluster; of three, each names both others
  --leaf-of HOST[:PORT]  a server of a cluster: this one stands at the edge, stores nothing, and
                         passes on what robots of its site say
  --address ADDRESS      where it listens (default 127.0.0.1: this computer alone)
  --port PORT            for robots (default 4222); PORT + 2000 is for peers, PORT + 3200 for
                         leaves, PORT + 4000 for monitoring, which always stays on this computer.
                         PORTs of peers are their ports for robots, too
  --max-file-gb N        as much may be stored (default 10)
END
}

die() { echo "server: $*" >&2; exit 1; }

# url HOST[:PORT] OFFSET: where a peer listens for other servers.
url() {
  local host=$1 port=4222
  if [[ $1 =~ ^(.*):([0-9]+)$ ]]; then
    host=${BASH_REMATCH[1]}
    port=${BASH_REMATCH[2]}
  fi
  echo "\"tls://servers:$password@$host:$((port + $2))\""
}
urls() {  # OFFSET PEER..
  local offset=$1 peer separator=''
  shift
  for peer in "$@"; do
    printf '%s%s' "$separator" "$(url "$peer" "$offset")"
    separator=', '
  done
}

# The first of the hosts by which the certificate calls it; others are told that name.
own_host() {
  openssl x509 -in "$place/own.pem" -noout -ext subjectAltName |
    sed -nE '2s/^ *(DNS|IP Address):([^,]*).*/\2/p'
}

# Of 2.10.0 or later. Earlier ones do not start with sync_interval.
takes_sync_interval() {
  local version
  version=$(nats-server --version) || die "nats-server is not installed here"
  version=${version##*v}
  [[ $(printf '%s\n2.10.0\n' "$version" | sort -V | head -n 1) == 2.10.0 ]]
}

# tls VERIFY: a block of its credentials.
tls() {
  echo "tls { cert_file: own.pem, key_file: own.key, ca_file: ca.pem, timeout: 5$1 }"
}

configuration() {
  echo "# Made by server.sh. Start it in this folder: nats-server -c server.conf"
  echo "server_name: \"$name\""
  echo "listen: \"$address:$port\""
  echo "client_advertise: \"$host:$port\""
  echo "http: \"127.0.0.1:$((port + 4000))\""
  tls ", verify_and_map: true"
  echo "authorization { include \"users.conf\" }"
  # Else what is asked of JetStream does not pass between a leaf and the cluster.
  # shellcheck disable=SC2016  # the servers' name of the account
  echo 'default_js_domain { "$G": "" }'
  if ((${#leaf_of[@]})); then
    echo "leafnodes {"
    echo "  remotes: [ { urls: [ $(urls 3200 "${leaf_of[@]}") ]"
    echo "               $(tls "") } ]"
    echo "}"
    return
  fi
  echo "jetstream {"
  echo "  store_dir: \".\""
  echo "  max_memory_store: 0"
  echo "  max_file_store: ${max_file_gb}GB"
  ! takes_sync_interval || echo "  sync_interval: always"
  echo "}"
  echo "leafnodes {"
  echo "  listen: \"$address:$((port + 3200))\""
  echo "  authorization { user: servers, password: \"$password\" }"
  echo "  $(tls ", verify: true")"
  echo "}"
  ((${#peers[@]})) || return 0
  echo "cluster {"
  echo "  name: splinemap"
  echo "  listen: \"$address:$((port + 2000))\""
  echo "  cluster_advertise: \"$host:$((port + 2000))\""
  echo "  authorization { user: servers, password: \"$password\", timeout: 5 }"
  echo "  $(tls ", verify: true")"
  echo "  routes: [ $(urls 2000 "${peers[@]}") ]"
  echo "}"
}

peers=() leaf_of=() arguments=()
address=127.0.0.1 port=4222 max_file_gb=10
while (($#)); do
  case $1 in
    -h | --help) usage; exit 0 ;;
    --peer) peers+=("${2:-}"); shift ;;
    --leaf-of) leaf_of+=("${2:-}"); shift ;;
    --address) address=${2:-}; shift ;;
    --port) port=${2:-}; shift ;;
    --max-file-gb) max_file_gb=${2:-}; shift ;;
    -*) usage >&2; exit 2 ;;
    *) arguments+=("$1") ;;
  esac
  shift || { usage >&2; exit 2; }
done
((${#arguments[@]} == 2)) || { usage >&2; exit 2; }
((!${#peers[@]} || !${#leaf_of[@]})) || die "a server at the edge has no peers"
[[ $port =~ ^[1-9][0-9]{0,4}$ ]] || die "--port wants a number"
((port < 61000)) || die "--port has to be below 61000"
[[ $max_file_gb =~ ^[1-9][0-9]{0,5}$ ]] || die "--max-file-gb wants a number"
for text in "$address" "${peers[@]}" "${leaf_of[@]}"; do
  [[ $text =~ ^[]a-zA-Z0-9.:[-]+$ ]] || die "'$text' is no address"
done
folder=${arguments[0]} name=${arguments[1]}
place=$folder/servers/$name
[[ -f $place/own.pem ]] ||
  die "$place has no credentials: make them with credentials.sh server $folder $name HOST"
password=$(< "$folder/servers.password")
host=$(own_host)
umask 077
configuration > "$place/server.conf.new"
mv "$place/server.conf.new" "$place/server.conf"
echo "wrote $place/server.conf"
