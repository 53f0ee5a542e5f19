#!/usr/bin/env bash
# Inside the Debian that cycle.sh boots.
set -euo pipefail
fail() { echo "FAILED: $*"; systemctl --no-pager --full status "weakgrid*" | tail -40; exit 1; }
said() { printf "%7.1f s  %s\n" "$(cut -d" " -f1 /proc/uptime)" "$*"; }
until_true() { # seconds, command
  local n
  for ((n = 0; n < $1 * 10; ++n)); do
    if "${@:2}" > /dev/null 2>&1; then return 0; fi
    sleep 0.1
  done
  return 1
}
show() { systemctl show --value -p "$2" "weakgrid-$1@feeder.service"; }
runs() { [ "$(show "$1" StatusText)" = running ]; }
services=(plant controller gateway recorder)
units=("${services[@]/#/weakgrid-}")
units=("${units[@]/%/@feeder}")

id weakgrid > /dev/null || fail "no user"
[ -z "$(systemctl list-unit-files 'weakgrid*' --state=enabled --no-legend)" ] || fail "something is enabled"
[ -z "$(systemctl list-units 'weakgrid*' --no-legend)" ] || fail "something runs"
[ ! -e /var/lib/weakgrid ] || fail "/var/lib/weakgrid before anything ran"
said "installed: user, nothing enabled, nothing runs"

cp /etc/weakgrid/example.toml /etc/weakgrid/feeder.toml
# As fast as may be: a busy machine misses times.
sed -i 's/^pace = .*/pace = "lockstep"/' /etc/weakgrid/feeder.toml
systemctl enable --quiet --now "${units[@]}"
systemctl is-enabled --quiet weakgrid@feeder.target || fail "the target is not enabled with its services"
for service in "${services[@]}"; do
  [ "$(show "$service" ActiveState)" = active ] || fail "$service is not active once start is over"
  until_true 30 runs "$service" || fail "$service: $(show "$service" StatusText)"
  [ "$(ps -o user= -p "$(show "$service" MainPID)")" = weakgrid ] || fail "$service runs as somebody else"
done
weakgrid set --p 0.4 --q 0.1 > /dev/null || fail "no setpoint"
until_true 10 test -s /var/lib/weakgrid/feeder/gateway.journal || fail "no journal"
ls /var/lib/weakgrid/feeder/recordings/*.mcap > /dev/null || fail "no recording"
[ "$(stat -c "%U %a" /var/lib/weakgrid/feeder)" = "weakgrid 750" ] || fail "the state: $(stat -c "%U %a" /var/lib/weakgrid/feeder)"
said "enabled and started: all say 'running', a setpoint is accepted, journal and recording are there"

pid=$(show controller MainPID)
kill -9 "$pid"
until_true 30 sh -c "[ \$(systemctl show --value -p NRestarts weakgrid-controller@feeder) = 1 ] && [ \"\$(systemctl show --value -p StatusText weakgrid-controller@feeder)\" = running ]" ||
  fail "the controller does not come back: $(show controller StatusText)"
said "controller killed: restarted by systemd and running"

mkdir -p /run/systemd/system/weakgrid-recorder@.service.d
printf '[Service]\nWatchdogSec=3\nTimeoutAbortSec=5\n' > /run/systemd/system/weakgrid-recorder@.service.d/quick.conf
systemctl daemon-reload
systemctl restart weakgrid-recorder@feeder
sleep 6
[ "$(show recorder NRestarts)" = 0 ] || fail "a recorder that goes on is restarted"
kill -STOP "$(show recorder MainPID)"
until_true 30 sh -c '[ "$(systemctl show --value -p NRestarts weakgrid-recorder@feeder)" = 1 ]' || fail "a recorder that stands is left alone"
journalctl -u weakgrid-recorder@feeder | grep -q 'Watchdog timeout' || fail "not the watchdog"
until_true 30 runs recorder || fail "the recorder does not come back"
said "recorder stopped: the watchdog restarts it, and no sooner"

echo 'no = "such key"' > /etc/weakgrid/wrong.toml
if systemctl start weakgrid-gateway@wrong 2> /dev/null; then fail "starts with wrong settings"; fi
sleep 3
[ "$(systemctl show --value -p NRestarts weakgrid-gateway@wrong)" = 0 ] || fail "tries again with wrong settings"
said "wrong settings: said once ($(journalctl -u weakgrid-gateway@wrong -o cat | grep wrong.toml: | tail -1))"

# What [realtime] asks, and shared memory, both through the confinement. Where process 1 itself may not raise a limit, as
# on some virtual machines, capabilities stand in for the limits, and only the rest of the confinement is proved.
means=limits
if (((0x$(awk '/^CapBnd/ { print $2 }' /proc/1/status) >> 24 & 1) == 0)); then
  means="capabilities (CAP_SYS_RESOURCE is missing here: LimitRTPRIO= and LimitMEMLOCK= are NOT proved)"
  for service in plant controller; do
    mkdir -p "/run/systemd/system/weakgrid-$service@.service.d"
    printf '[Service]\nCapabilityBoundingSet=CAP_SYS_NICE CAP_IPC_LOCK\nAmbientCapabilities=CAP_SYS_NICE CAP_IPC_LOCK\n' \
      > "/run/systemd/system/weakgrid-$service@.service.d/limits.conf"
  done
  systemctl daemon-reload
fi
sed -i 's/^priority = .*/priority = 50/; s/^lock_memory = .*/lock_memory = true/; s/^interfaces.*/&\nloop = "data_sharing"/' /etc/weakgrid/feeder.toml
systemctl restart weakgrid@feeder.target
for service in "${services[@]}"; do until_true 40 runs "$service" || fail "$service: $(show "$service" StatusText)"; done
for service in plant controller; do
  pid=$(show "$service" MainPID)
  [ "$(ps -L -o cls= -p "$pid" | grep -c FF)" -ge 1 ] || fail "$service has no thread with SCHED_FIFO"
  [ "$(awk '/^VmLck/ { print $2 }' "/proc/$pid/status")" -gt 1000 ] || fail "$service has not locked its memory"
  grep -q /dev/shm/ "/proc/$pid/maps" || fail "$service shares no memory"
done
said "restarted by its target: SCHED_FIFO, locked and shared memory by $means"

pids=$(for service in "${services[@]}"; do show "$service" MainPID; done)
echo '# edited' >> /etc/weakgrid/example.toml
dpkg --force-confold -i /next.deb > /dev/null
[ "$pids" = "$(for service in "${services[@]}"; do show "$service" MainPID; done)" ] || fail "the upgrade has restarted something"
grep -q edited /etc/weakgrid/example.toml || fail "the upgrade has taken the settings"
said "upgraded: the same processes, settings kept"

dpkg -r weakgrid > /dev/null
[ -z "$(pgrep -u weakgrid || true)" ] || fail "something runs after removal"
[ -z "$(ls /dev/shm)" ] || fail "left in /dev/shm: $(ls /dev/shm)"
[ -s /var/lib/weakgrid/feeder/gateway.journal ] && [ -e /etc/weakgrid/example.toml ] || fail "removal has taken data or settings"
[ ! -e /usr/bin/weakgrid ] || fail "removal has left the program"
dpkg -P weakgrid > /dev/null 2> /purge.log
grep -q 'is kept' /purge.log || fail "the purge does not say what it leaves: $(cat /purge.log)"
[ -s /var/lib/weakgrid/feeder/gateway.journal ] || fail "the purge has taken the journal"
[ ! -e /etc/weakgrid/example.toml ] && [ -e /etc/weakgrid/feeder.toml ] || fail "the purge has not taken its settings, or others"
[ -z "$(find /etc/systemd/system -name 'weakgrid*')" ] || fail "links are left: $(find /etc/systemd/system -name 'weakgrid*')"
said "removed and purged: journal and recordings kept, and that is said"
