# To be sourced: Prometheus's checker without Prometheus, whose package starts a server that listens everywhere.

# find_promtool INTO: sets `promtool` to the machine's, or to that of Debian's package, unpacked into INTO.
find_promtool() {
  local into=$1
  promtool=$(command -v promtool) && return
  promtool=$into/usr/bin/promtool
  mkdir -p "$into"
  exec 9> "$into/.lock"
  flock 9
  if [ ! -x "$promtool" ]; then
    (cd "$into" && apt-get -qq download prometheus && dpkg-deb --extract prometheus_*.deb . && rm prometheus_*.deb) ||
      { echo "promtool: Debian's package prometheus cannot be had" >&2; exit 3; }
  fi
  exec 9>&-
}
