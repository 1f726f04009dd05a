# bash completion for splinemap, splinemapd, splinemap-viewer, -uplink and -fleet-worker  -*- shell-script -*-
# Commands and flags are those that --help lists, so there is no list to keep up to date.

_splinemap() {
  local word=${COMP_WORDS[COMP_CWORD]} program=${COMP_WORDS[0]} command=() candidate help
  for candidate in "${COMP_WORDS[@]:1:COMP_CWORD-1}"; do
    [[ $candidate =~ ^[a-z][a-z-]*$ ]] || break
    command+=("$candidate")
  done
  # The longest beginning that is a command: behind it stand files and numbers.
  until help=$("$program" "${command[@]}" --help 2> /dev/null); do
    ((${#command[@]})) || return 0
    unset 'command[-1]'
  done
  local flags commands
  flags=$(awk '/^  -/ { gsub(/,/, " "); for (k = 1; $k ~ /^-/; ++k) print $k }' <<< "$help")
  commands=$(awk '/^Subcommands:/ { inside = 1; next } NF == 0 { inside = 0 } inside { print $1 }' \
    <<< "$help")
  if [[ $word == -* ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$flags" -- "$word")
  elif [[ -n $commands ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$commands" -- "$word")
  fi
}
# Where there is nothing to propose: files.
complete -o default -F _splinemap splinemap splinemapd splinemap-viewer splinemap-uplink splinemap-fleet-worker
