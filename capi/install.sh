#!/usr/bin/env bash
# Installs library, headers, CMake and pkg-config files of the C and C++ interface:
#   capi/install.sh PREFIX [BUILT]
# BUILT is a folder that has the libraries already; without it they are built for release.
set -euo pipefail
[ $# -ge 1 ] || { echo "usage: $0 PREFIX [BUILT]" >&2; exit 2; }
mkdir -p "$1"
prefix=$(cd "$1" && pwd)
target=${2:+$(cd "$2" && pwd)}
cd "$(dirname "$0")"

if [ -z "$target" ]; then
  cargo build --quiet --release -p lumenmesh-capi
  target=${CARGO_TARGET_DIR:-../target}/release
fi
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' ../Cargo.toml)
library=liblumenmesh.so
[ -e "$target/$library" ] || library=liblumenmesh.dylib

mkdir -p "$prefix/include" "$prefix/lib/cmake/lumenmesh" "$prefix/lib/pkgconfig" \
  "$prefix/share/doc/lumenmesh"
install -m 644 ../LICENSE-MIT ../LICENSE-APACHE ../THIRD_PARTY_NOTICES "$prefix/share/doc/lumenmesh/"
install -m 644 include/lumenmesh.h include/lumenmesh.hpp "$prefix/include/"
install -m 755 "$target/$library" "$prefix/lib/"
install -m 644 "$target/liblumenmesh.a" "$prefix/lib/"
fill() { sed -e "s|@PREFIX@|$prefix|" -e "s|@VERSION@|$version|" -e "s|@LIBRARY@|$library|" "$1" >"$2"; }
fill cmake/lumenmeshConfig.cmake.in "$prefix/lib/cmake/lumenmesh/lumenmeshConfig.cmake"
fill cmake/lumenmeshConfigVersion.cmake.in "$prefix/lib/cmake/lumenmesh/lumenmeshConfigVersion.cmake"
fill lumenmesh.pc.in "$prefix/lib/pkgconfig/lumenmesh.pc"
echo "installed lumenmesh $version in $prefix"
