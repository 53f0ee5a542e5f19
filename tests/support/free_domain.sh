# To be sourced: a DDS domain that no other test on this machine has, as tests/support/test_domain.hpp does it.

# Sets `domain`; it is ours until the shell ends.
free_domain() {
  local lock
  for domain in {215..229}; do
    lock=${TMPDIR:-/tmp}/weakgrid-test-domain-$domain.lock
    [ -e "$lock" ] || (umask 0 && : >> "$lock")
    exec 8< "$lock"
    if flock -n 8; then return; fi
  done
  echo "no DDS domain is free for a test" >&2
  exit 3
}
