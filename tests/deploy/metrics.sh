#!/usr/bin/env bash
# The alert rules and the dashboard in Prometheus' own checker; and what they ask for, the console says.
# usage: metrics.sh SOURCE BUILD
set -euo pipefail
source=$1
fail() { echo "metrics.sh: $*" >&2; exit 1; }
# shellcheck source=tests/support/promtool.sh
source "$source/tests/support/promtool.sh"
find_promtool "$2/prometheus"
metrics=$source/deploy/metrics
"$promtool" check rules "$metrics/weakgrid.rules.yml"
(cd "$metrics" && "$promtool" test rules weakgrid.rules.test.yml)

# Every query of the dashboard as a rule of its own; Grafana fills in what begins with $.
scratch=$(mktemp -d)
trap 'rm -rf -- "$scratch"' EXIT
node -e '
  const { panels } = JSON.parse(require("fs").readFileSync(process.argv[1], "utf8"));
  const queries = panels.flatMap(({ targets }) => targets.map(({ expr }) => expr));
  console.log("groups:\n- name: dashboard\n  rules:");
  for (const [n, query] of queries.entries())
    console.log(`  - record: query_${n}\n    expr: ${JSON.stringify(query.replace("$__rate_interval", "1m"))}`);
' "$metrics/weakgrid.dashboard.json" > "$scratch/queries.yml"
"$promtool" check rules "$scratch/queries.yml"

# Their names are the counters of metrics.cpp, as gauges or totals, or its other families.
names=$(grep -oh 'weakgrid_[a-z_]*' "$metrics"/weakgrid.rules.yml "$metrics/weakgrid.dashboard.json" | sort -u)
known=$(sed -n 's/^    {"\([a-z_]*\)", ".*/\1/p; s/.*out\.add("\([a-z_]*\)".*/\1/p' "$source/services/console/metrics.cpp")
for name in $names; do
  plain=${name#weakgrid_}
  [ -n "$plain" ] || continue
  grep -qxF -e "$plain" -e "${plain%_total}" -e "${plain%_bucket}" <<< "$known" || fail "nobody says $name"
done
echo "$(wc -w <<< "$names") names"
