#!/usr/bin/env bash
# The dependency rule, model ← {plant, controller, gateway} ← services: Debian installs Fast DDS into the default
# include path, so the build cannot stop a wrong include.
# It reads includes and names, not link lines, and nothing behind a macro.
set -euo pipefail

usage() {
  cat <<'EOF'
usage: dependency_rule.sh REPOSITORY | --self-test

  REPOSITORY    the repository's root: prints every line that breaks the rule
  --self-test   makes small trees, with and without violations, and checks that exactly the violations are found

exit code: 0 the rule holds, 1 it does not, 2 bad usage
EOF
}

# Prints FILE:LINE: reason: text for each offending line below the working directory.
offences() {
  find plant controller gateway services tests -type f -regextype posix-extended \
    -regex '.*\.(hpp|cpp|h|cc|cxx|ipp|inc)' -print0 | LC_ALL=C sort -z | LC_ALL=C xargs -0 -r awk '
    BEGIN {
      n = split("algorithm any array bit bitset cassert cctype cerrno cfenv cfloat charconv cinttypes climits cmath " \
        "compare complex concepts cstdarg cstddef cstdint cstdlib cstring deque exception forward_list functional " \
        "initializer_list iomanip ios iosfwd istream iterator limits list locale map memory memory_resource new " \
        "numbers numeric optional ostream queue random ranges ratio regex set source_location span sstream stack " \
        "stdexcept streambuf string string_view tuple type_traits typeindex typeinfo unordered_map unordered_set " \
        "utility valarray variant vector version", names, " ")
      for (k = 1; k <= n; ++k) harmless[names[k]]
      pure["plant"]; pure["controller"]; pure["gateway"]
      # The same things by name, as they also come in through other headers.
      world = "(^|[^A-Za-z0-9_])(std::(chrono|thread|jthread|mutex|[a-z]+_mutex|condition_variable|async|future|atomic" \
        "|filesystem|[io]?fstream|cout|cerr|clog|cin|getenv|system)|f?printf|fopen|puts|spdlog::[a-z]+|clock_gettime" \
        "|eprosima)([^A-Za-z0-9_]|$)"
    }

    function offence(reason) { printf "%s:%d: %s: %s\n", FILENAME, FNR, reason, $0 }

    function exists(file,   line, found) { found = (getline line < file) >= 0; close(file); return found }

    # The line without comments, and without what stands in quotes unless it is the file of an #include.
    function code_of(line,   out, n, k, two, c, end) {
      n = length(line)
      for (k = 1; k <= n; ++k) {
        c = substr(line, k, 1); two = substr(line, k, 2)
        if (in_comment) {
          if (two == "*/") { in_comment = 0; ++k; out = out " " }
        } else if (two == "/*") {
          in_comment = 1; ++k
        } else if (two == "//") {
          break
        } else if (c == "\"") {
          for (end = k + 1; end <= n && substr(line, end, 1) != "\""; ++end) if (substr(line, end, 1) == "\\") ++end
          out = out (out ~ /^[ \t]*#[ \t]*include[ \t]*$/ ? substr(line, k, end - k + 1) : "\"\"")
          k = end
        } else if (c == "\047" && substr(line, k) ~ /^\047(\\.|[^\\])\047/) {
          k += substr(line, k + 1, 1) == "\\" ? 3 : 2
        } else {
          out = out c
        }
      }
      return out
    }

    # Empty when a file of a pure room may include it.
    function why_not(file, quoted) {
      if (file ~ /(^|\/)\.\.(\/|$)/) return "leaves its folder"
      if (file == "plant/model.hpp") return ""
      if (index(file, room "/") == 1) return exists(file) ? "" : "no such file"
      if (file ~ /^services\//) return "a pure room includes services"
      if (file ~ /^(plant|controller|gateway)\//) return "pure rooms do not see each other"
      if (file ~ /^Eigen\//) return room == "controller" ? "" : "Eigen is for controller/ alone"
      if (quoted && exists(folder "/" file)) return ""
      if (!quoted && file in harmless) return ""
      return "not for a pure room"
    }

    FNR == 1 {
      in_comment = 0
      room = FILENAME; sub(/\/.*/, "", room)
      folder = FILENAME; sub(/\/[^\/]*$/, "", folder)
      # The benchmark of round trips compares with raw DDS; so are peers and intruders.
      may_see_dds = FILENAME ~ /^(services\/runtime\/|tests\/bench\/roundtrip\/|tests\/services\/(foreign_peer|security_test)\.cpp$)/
    }
    { code = code_of($0) }
    code ~ /^[ \t]*#[ \t]*include/ {
      file = code; sub(/^[ \t]*#[ \t]*include(_next)?[ \t]*/, "", file); sub(/[ \t\r]*$/, "", file)
      quoted = file ~ /^"/
      if (file !~ /^("[^"]+"|<[^>]+>)$/) { if (room in pure) offence("not readable by this test"); next }
      file = substr(file, 2, length(file) - 2)
      if (!may_see_dds && file ~ /(^|\/)((fastdds|fastrtps|fastcdr)\/.*|weakgrid[A-Za-z]*\.(h|hpp|ipp))$/)
        offence("only services/runtime/ sees DDS and generated code")
      else if (room in pure && (reason = why_not(file, quoted)) != "")
        offence(reason)
      next
    }
    room in pure && code ~ world { offence("a pure room sees no clock, file, thread, log or DDS") }
  '
}

check() {
  local room found
  cd -- "$1"
  for room in plant controller gateway services tests; do
    [ -d "$room" ] || { echo "dependency_rule.sh: $1 has no $room/: is it the repository's root?" >&2; return 2; }
  done
  for room in plant controller gateway; do
    [ -n "$(find "$room" -name '*.hpp' -print -quit)" ] ||
      { echo "dependency_rule.sh: no header in $room/, nothing to check" >&2; return 1; }
  done
  found=$(offences)
  [ -z "$found" ] || { printf '%s\n' "$found"; return 1; }
}

# A line that ends in BAD breaks the rule; every other one keeps it.
write_sample() {
  mkdir -p plant controller gateway/part services/runtime services/web tests/laws
  cat > plant/model.hpp <<'EOF'
#include <cmath>
#include <complex>  // #include <thread>
/* #include <mutex>
#include "services/web/page.hpp" */ inline const char* text = "/*";
#include <chrono>  // BAD
#include <Eigen/Dense>  // BAD
/* why */ #include <thread>  // BAD
inline const char* quoted = "std::chrono";
inline auto separated = 1'000'000; inline char quote = '"';  // std::thread
inline auto now() { return std::chrono::steady_clock::now(); }  // BAD
EOF
  cat > plant/plant.cpp <<'EOF'
#include "plant/plant.hpp"  // BAD
#include "plant/model.hpp"
#include "model.hpp"
#include "controller/notch.hpp"  // BAD
#include "notch.hpp"  // BAD
#include "../controller/notch.hpp"  // BAD
  #  include   <fstream>  // BAD
#include<iostream>  // BAD
#include <filesystem>  // BAD
#include <cstdio>  // BAD
#include <stdio.h>  // BAD
#include <mutex>  // BAD
#include <spdlog/spdlog.h>  // BAD
#include <fmt/format.h>  // BAD
#include SOME_HEADER  // BAD
void f() { printf("x"); }  // BAD
void g() { spdlog::info("x"); }  // BAD
int snprintf_like, my_thread;
EOF
  cat > controller/notch.hpp <<'EOF'
#include <Eigen/Dense>
#include <vector>
#include <plant/model.hpp>
#include "plant/plant.hpp"  // BAD
#include <services/runtime/node.hpp>  // BAD
#include <fastdds/dds/domain/DomainParticipant.hpp>  // BAD
#include "weakgrid.h"  // BAD
EOF
  cat > gateway/envelope.hpp <<'EOF'
#include "part/arc.hpp"
#include "gateway/part/arc.hpp"
#include "plant/model.hpp"
#include "Eigen/Core"  // BAD
#include "services/web/page.hpp"  // BAD
#include "controller/notch.hpp"  // BAD
EOF
  echo '#include <semaphore>  // BAD' > gateway/part/arc.hpp
  cat > services/runtime/node.hpp <<'EOF'
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include "weakgridPubSubTypes.h"
#include <thread>
EOF
  cat > services/web/page.hpp <<'EOF'
#include <thread>
#include "gateway/envelope.hpp"
#include "services/runtime/node.hpp"
#include <fastrtps/types/TypesBase.h>  // BAD
#include "generated/weakgridPubSubTypes.hpp"  // BAD
#include "generated/weakgrid.h"  // BAD
EOF
  cat > tests/laws/law.cpp <<'EOF'
#include "controller/notch.hpp"
#include "plant/model.hpp"
#include <iostream>
#include <fastcdr/Cdr.h>  // BAD
#include "weakgridPubSubTypes.h"  // BAD
EOF
}

self_test() {
  local expected found
  scratch=$(mktemp -d)
  trap 'rm -rf "$scratch"' EXIT
  mkdir "$scratch/bad" "$scratch/clean"
  (cd "$scratch/bad" && write_sample)
  (cd "$scratch/clean" && write_sample && find . -type f -exec sed -i '/BAD$/d' {} +)

  expected=$(cd "$scratch/bad" && grep -rn 'BAD$' . | sed -E 's,^\./([^:]*:[0-9]+):.*,\1,' | LC_ALL=C sort)
  found=$( (check "$scratch/bad" || true) | sed -E 's,^([^:]*:[0-9]+):.*,\1,' | LC_ALL=C sort)
  if [ "$expected" != "$found" ]; then
    echo "dependency_rule.sh: marked in the sample (<) and found (>) differ:" >&2
    diff <(printf '%s\n' "$expected") <(printf '%s\n' "$found") >&2 || true
    return 1
  fi
  if (check "$scratch/bad") > /dev/null; then
    echo "dependency_rule.sh: a tree with violations passes" >&2
    return 1
  fi
  (check "$scratch/clean") || { echo "dependency_rule.sh: a clean tree does not pass" >&2; return 1; }
  rm "$scratch/clean/gateway/envelope.hpp" "$scratch/clean/gateway/part/arc.hpp"
  if (check "$scratch/clean") 2> /dev/null; then
    echo "dependency_rule.sh: an empty room passes" >&2
    return 1
  fi
  echo "self-test: $(wc -l <<< "$expected") violations marked, the same found"
}

case "${1:-} $#" in
  "--self-test 1") self_test ;;
  "-h 1" | "--help 1") usage ;;
  -*\ 1 | *\ 0) usage >&2; exit 2 ;;
  *\ 1) [ -d "$1" ] || { echo "dependency_rule.sh: '$1' is no folder" >&2; exit 2; }
    check "$1" ;;
  *) usage >&2; exit 2 ;;
esac
