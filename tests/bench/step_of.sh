# step_of FOLDER_OF_PROGRAMS DOMAIN UNIT [ARGUMENTS of weakgrid status ...]: of the unit's last sample, health is up to a second old. Nothing: none has come.
step_of() {
  { "$1/weakgrid" status --domain "$2" --unit "$3" "${@:4}" --json || true; } |
    awk -F'[:,]' '/"measurement"/ { here = 1 } here && /"step"/ { print $2 + 0; here = 0 }'
}
