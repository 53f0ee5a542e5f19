#!/usr/bin/env bash
# The real services on hosts of their own: network namespaces joined by a bridge, in a network that is this test's
# alone. Discovery by multicast, by named peers and by a Discovery Server (the last two with multicast dropped), secured;
# peers made of deploy/dds's own XML; a link that goes down and comes up; and a laptop that exposes nothing.
# All of it, programs too, is in namespaces of this script and ends with it, also if that is killed.
# usage: hosts.sh FOLDER_OF_PROGRAMS FOREIGN_PEER FOLDER_OF_DEPLOY WAY
#   WAY: alone, multicast, peers, discovery_server, secured
# exit code: 0 held, 1 did not, 2 bad usage, 77 this user or kernel may make no network namespaces
set -euo pipefail

if [ "${1:-}" != --inside ]; then
  [ $# -eq 4 ] || { sed -n '/^# usage/,/^# exit/p' "$0" >&2; exit 2; }
  as_root=()
  [ "$(id -u)" -eq 0 ] || as_root=(--user --map-root-user)
  if ! why=$(unshare "${as_root[@]}" --net --mount --pid --fork --kill-child --mount-proc \
    sh -c 'mount -t tmpfs none /run && mkdir /run/netns && ip netns add probe' 2>&1); then
    echo "hosts.sh: skipped, no network namespaces here: $why"
    exit 77
  fi
  exec unshare "${as_root[@]}" --net --mount --pid --fork --kill-child --mount-proc "$0" --inside "$@"
fi

bin=$2 peer=$3 deploy=$4 way=$5
mount -t tmpfs none /run && mkdir /run/netns /run/work && cd /run/work

fail() {
  echo "hosts.sh: $way: $*" >&2
  tail -n 30 ./*.log >&2
  exit 1
}

# on HOST COMMAND ...: there, and in its own words.
on() { ip netns exec "host$1" "${@:2}"; }

# host N: 192.168.7.N on the common network.
host() {
  ip netns add "host$1"
  ip link add "port$1" type veth peer name eth0 netns "host$1"
  ip link set "port$1" master bridge up
  ip -n "host$1" link set lo up
  ip -n "host$1" addr add "192.168.7.$1/24" dev eth0
  ip -n "host$1" link set eth0 up
}

# settings HOST: what this host's programs are told; what they share is in $common.
settings() {
  { printf '%s\n' "$pace"
    echo '[dds]'; echo "interfaces = [\"192.168.7.$1\"]"; printf '%s\n' "$common"; } > "host$1.toml"
}

# start HOST PROGRAM [ARGUMENTS ...]
declare -A pid
start() {
  ip netns exec "host$1" "$bin/weakgrid-$2" --settings "host$1.toml" "${@:3}" > "$2.log" 2>&1 &
  pid[$2]=$!
}

stop() {
  local program
  for program in "$@"; do kill "${pid[$program]}"; done
  for program in "$@"; do wait "${pid[$program]}" || fail "$program has not ended well"; done
}

# The unit's last sample, as host 3 sees it now. A server takes its time to tell a newcomer of the others.
step() {
  { on 3 "$bin/weakgrid" status --settings host3.toml --wait "$([ "$way" = discovery_server ] && echo 3 || echo 1)" --json ||
    true; } |
    awk -F'[:,]' '/"measurement"/ { here = 1 } here && /"step"/ { print $2 + 0; exit }'
}

# goes_on SECONDS: within these the loop has a later step than now.
goes_on() {
  local end=$((SECONDS + $1)) first now
  first=$(step)
  while [ $SECONDS -lt $end ]; do
    now=$(step)
    [ -n "$first" ] || first=$now
    [ -z "$now" ] || [ "$now" -le "$first" ] || return 0
  done
  return 1
}

# What is started with defaults neither listens on nor sends from any address but the loopback's.
alone() {
  host 1
  on 1 nft -f - <<'N'
table ip watch {
  counter outside { }
  counter inside { }
  chain out {
    type filter hook output priority 0;
    oifname "lo" ip protocol udp counter name inside
    oifname != "lo" counter name outside
  }
}
N
  echo '[grid]' > host1.toml
  for program in plant controller gateway; do start 1 $program; done
  start 1 recorder --output alone.mcap
  on 1 "$bin/weakgrid" set --p 0.3 --q 0 --vc 1.8385 --timeout 30 > /dev/null || fail "the loop does not run"
  local packets
  packets() { on 1 nft list counter ip watch "$1" | sed -n 's/.*packets \([0-9]*\).*/\1/p'; }
  [ "$(packets inside)" -gt 100 ] || fail "the watch sees nothing"
  [ "$(packets outside)" -eq 0 ] || fail "$(packets outside) packets have left by another interface than lo"
  # Bound to 127.0.0.1, or to a multicast group, which then must have been joined on lo only.
  local bound
  bound=$(on 1 ss -Hltun | awk '{ print $5 }' | sed 's/:[0-9]*$//; s/%.*//' | sort -u | tr '\n' ' ')
  [ -n "$bound" ] || fail "ss sees nothing"
  for address in $bound; do
    case $address in 127.0.0.1 | 239.255.0.1) ;; *) fail "something listens on $address" ;; esac
  done
  ! on 1 ip -4 maddr show dev eth0 | grep -q 239.255.0.1 || fail "the group is joined on eth0"
  stop plant controller gateway recorder
  echo "hosts.sh: alone: bound to $bound; $(packets inside) packets on lo, none elsewhere"
}

across() {
  local profile=$deploy/dds/$way.xml
  # The one profile that has to be written otherwise for the next major.
  ! ldd "$peer" | grep -q libfastdds || [ "$way" != discovery_server ] || profile=${profile%.xml}_3.xml
  for n in 1 2 3 4 5; do host $n; done
  common=
  case $way in
    peers | secured) common='peers = ["192.168.7.1", "192.168.7.2", "192.168.7.3", "192.168.7.4"]' ;;
    discovery_server) common='discovery_server = "192.168.7.5:11811"' ;;
  esac
  if [ "$way" = secured ]; then
    "$deploy/security/make" keys > make.log 2>&1 || fail "no keys"
    common+=$'\nsecurity = "keys"'
  fi
  if [ "$way" != multicast ]; then
    for n in 1 2 3 4 5; do
      on $n nft -f - <<'N'
table ip no_multicast {
  chain in { type filter hook input priority 0; ip daddr 224.0.0.0/4 drop; }
  chain out { type filter hook output priority 0; ip daddr 224.0.0.0/4 drop; }
}
N
    done
  fi
  [ "$way" != discovery_server ] ||
    { on 5 fast-discovery-server -i 0 -l 192.168.7.5 -p 11811 > server.log 2>&1 & }

  # In lockstep: a setpoint is accepted, peers made of our XML take part, the recording is right to the bit.
  pace=$'[grid]\nreactance = 0.3\n[plant]\npatience_s = 60.0'
  for n in 1 2 3 4; do settings $n; done
  start 3 recorder --output run.mcap --await weakgrid/measurement --await weakgrid/modulation
  start 2 controller
  start 3 gateway
  start 1 plant
  on 3 "$bin/weakgrid" set --settings host3.toml --p 0.5 --q 0.1 --vc 1.8385 --timeout 30 > set.log 2>&1 ||
    fail "no setpoint is accepted: $(cat set.log)"
  on 4 "$peer" 0 "$deploy/dds/topics.xml" "$profile" > peer.log 2>&1 || fail "the peer: $(cat peer.log)"

  # The controller's host is cut off, and comes back.
  ip -n host2 link set eth0 down
  sleep 0.2
  local before= after=
  # Who asks has to be let in first, which may take more than a moment.
  for _ in {1..15}; do before=${before:-$(step)}; done
  for _ in {1..15}; do after=${after:-$(step)}; done
  [ -n "$before" ] && [ "$before" = "$after" ] || fail "steps $before … $after while the controller was cut off"
  ip -n host2 link set eth0 up
  goes_on 30 || fail "the loop has not come back after its link has"
  stop plant controller gateway recorder
  "$bin/weakgrid" verify run.mcap > verify.log 2>&1 || fail "the recording: $(cat verify.log)"

  # In real time, briefly: slow and with wide limits, since nobody promises a busy machine's scheduling.
  pace=$'[grid]\nreactance = 0.1\n[timing]\nperiod_us = 500\n[plant]\npace = "realtime"
[protection]\ncurrent_max = 50.0\ndc_voltage_min = 0.05\ndc_voltage_max = 10.0\npcc_voltage_steps = 100000\nholds_max = 100000
[controller]\nsettling_times_s = [0.005, 0.0055, 0.2]\nnotch_settling_time_s = 0.25
[gateway]\ndecay_min_per_s = 1.0'
  for n in 1 2 3 4; do settings $n; done
  for program in controller=2 gateway=3 plant=1; do start "${program#*=}" "${program%=*}"; done
  on 3 "$bin/weakgrid" set --settings host3.toml --p 0.3 --q 0 --vc 1.8385 --timeout 30 > set.log 2>&1 ||
    fail "in real time no setpoint is accepted: $(cat set.log)"
  goes_on 20 || fail "in real time the unit stands still"
  on 3 "$bin/weakgrid" status --settings host3.toml --json > status.log || fail "in real time: $(cat status.log)"
  stop plant controller gateway
  echo "hosts.sh: $way: $(cat peer.log); $(tail -n 1 verify.log)"
}

ip link add bridge type bridge mcast_snooping 0
ip link set bridge up
if [ "$way" = alone ]; then alone; else across; fi
