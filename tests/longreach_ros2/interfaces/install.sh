#!/usr/bin/env bash
# Builds the two message packages that PyPI has not, with the generators that it has, into the environment named.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
prefix=$(cd "$1" && pwd)
python=$prefix/bin/python
include=$("$python" -c "import sysconfig; print(sysconfig.get_path('include'))")
# The wheels' cmake files name the directories of the machine that made them.
ln -sfn "$include" "$prefix/include/$(basename "$include")"
{ grep -rlE "/opt/python/cp[0-9]+-cp[0-9]+" "$prefix/share" || true; } | xargs -r sed -i -E "s#/opt/python/cp[0-9]+-cp[0-9]+#$prefix#g"
export PATH=$prefix/bin:$PATH AMENT_PREFIX_PATH=$prefix
build=$(mktemp -d)
trap 'rm -rf "$build"' EXIT
for package in tf2_msgs control_msgs; do
  cmake -S "$here/$package" -B "$build/$package" -DCMAKE_PREFIX_PATH="$prefix" -DCMAKE_INSTALL_PREFIX="$prefix" \
    -DPython3_EXECUTABLE="$python" -DBUILD_TESTING=OFF > "$build/log" 2>&1 || { tail -30 "$build/log" >&2; exit 1; }
  cmake --build "$build/$package" --target install --parallel 2 > "$build/log" 2>&1 || { tail -30 "$build/log" >&2; exit 1; }
done
