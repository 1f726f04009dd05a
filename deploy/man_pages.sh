#!/usr/bin/env bash
# man_pages.sh FOLDER: writes the man pages of the programs on the PATH there: what --help says.
set -euo pipefail
out=$1
mkdir -p "$out"
# help2man runs one program.
tools=$(mktemp -d)
trap 'rm -rf "$tools"' EXIT

# page NAME COMMAND..: NAME.1 of the command.
page() {
  local name=$1 tool=$tools/$1 help version
  shift
  help=$("$@" --help)
  version=$("$1" --version)
  # The description, which help2man has apart; flags and examples as it expects them.
  local about=${help%%$'\n'*}
  about=${about#"$1: "}
  # shellcheck disable=SC2016  # sed's
  { echo '#!/bin/sh'; echo "cat << 'END_OF_HELP'"
    tail -n +2 <<< "$help" | sed -E 's/^(  -[a-zA-Z]),(--)/\1, \2/; s/^(Examples?|Positionals|Subcommands):$/*\1*/'
    echo END_OF_HELP; } > "$tool"
  chmod +x "$tool"
  help2man --no-info --no-discard-stderr --section 1 --source splinemap --manual "splinemap" \
    --version-string "$version" --name "${about%.}" "$tool" |
    awk -v header=".TH ${name^^} 1 \"\" \"splinemap $version\" splinemap" '
      /^\.TH / { print header; next }
      verbatim && /^\.(PP|SH|TP)/ { print ".fi"; verbatim = 0 }
      /^\.SH / { examples = /EXAMPLE/ }
      { print }
      examples && /^\.IP/ && !verbatim { print ".nf"; verbatim = 1 }' > "$out/$name.1"
}

# subcommands [COMMAND]: as --help lists them.
subcommands() {
  splinemap "$@" --help |
    awk '/^Subcommands:/ { inside = 1; next } NF == 0 { inside = 0 } inside { print $1 }'
}

page splinemapd splinemapd
page splinemap splinemap
for program in splinemap-viewer splinemap-uplink splinemap-fleet-worker; do
  ! command -v "$program" > /dev/null || page "$program" "$program"
done
while read -r command; do
  page "splinemap-$command" splinemap "$command"
  while read -r sub; do
    page "splinemap-$command-$sub" splinemap "$command" "$sub"
  done < <(subcommands "$command")
done < <(subcommands)
