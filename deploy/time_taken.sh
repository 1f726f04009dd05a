# shellcheck shell=bash
# Sourced by scripts that say at their end how long they took.

# print_time_taken WHAT: since the shell began, with all processes that it has waited for.
print_time_taken() {
  local fields
  read -ra fields < "/proc/$$/stat"
  printf '%s took %d min %02d s, and %d s of CPU\n' "$1" $((SECONDS / 60)) $((SECONDS % 60)) \
    $(((fields[15] + fields[16]) / $(getconf CLK_TCK))) >&2
}
