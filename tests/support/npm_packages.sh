# To be sourced: npm packages for tests, by the lock, into the build tree.

# install_packages FROM INTO: what FROM/package-lock.json names, once for that lock; parallel callers wait for the first.
install_packages() {
  local from=$1 into=$2 file
  mkdir -p "$into"
  exec 9> "$into/.lock"
  flock 9
  if cmp -s "$from/package-lock.json" "$into/node_modules/.installed-lock" &&
    cmp -s "$from/package.json" "$into/package.json"; then
    return
  fi
  for file in package.json package-lock.json; do cp "$from/$file" "$into/$file"; done
  if ! (cd "$into" && npm ci --ignore-scripts --no-audit --no-fund); then
    echo "npm ci failed in $into, see above" >&2
    exit 3
  fi
  cp "$from/package-lock.json" "$into/node_modules/.installed-lock"
}
