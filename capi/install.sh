#!/usr/bin/env bash
# Installs library, headers, CMake and pkg-config files of the C and C++ interface:
#   [DESTDIR=FOLDER] capi/install.sh PREFIX [BUILT]
# BUILT is a folder that has the libraries already; without it they are built for release. With DESTDIR, files go below
# that folder, and say that they are in PREFIX, an absolute path: that is how packages are made.
set -euo pipefail
[ $# -ge 1 ] || { echo "usage: $0 PREFIX [BUILT]" >&2; exit 2; }
if [ -n "${DESTDIR:-}" ]; then
  case $1 in /*) prefix=${1%/} ;; *) echo "$0: with DESTDIR, PREFIX must be absolute, and is $1" >&2; exit 2 ;; esac
else
  mkdir -p "$1"
  prefix=$(cd "$1" && pwd)
fi
mkdir -p "${DESTDIR:-}$prefix"
there=$(cd "${DESTDIR:-}$prefix" && pwd)
target=${2:+$(cd "$2" && pwd)}
cd "$(dirname "$0")"

if [ -z "$target" ]; then
  cargo build --quiet --release -p lumenmesh-capi
  target=${CARGO_TARGET_DIR:-../target}/release
fi
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' ../Cargo.toml)
library=liblumenmesh.so
[ -e "$target/$library" ] || library=liblumenmesh.dylib

mkdir -p "$there/include" "$there/lib/cmake/lumenmesh" "$there/lib/pkgconfig" "$there/share/doc/lumenmesh"
install -m 644 ../LICENSE-MIT ../LICENSE-APACHE ../THIRD_PARTY_NOTICES "$there/share/doc/lumenmesh/"
install -m 644 include/lumenmesh.h include/lumenmesh.hpp "$there/include/"
install -m 755 "$target/$library" "$there/lib/"
install -m 644 "$target/liblumenmesh.a" "$there/lib/"
fill() { sed -e "s|@PREFIX@|$prefix|" -e "s|@VERSION@|$version|" -e "s|@LIBRARY@|$library|" "$1" >"$2"; }
fill cmake/lumenmeshConfig.cmake.in "$there/lib/cmake/lumenmesh/lumenmeshConfig.cmake"
fill cmake/lumenmeshConfigVersion.cmake.in "$there/lib/cmake/lumenmesh/lumenmeshConfigVersion.cmake"
fill lumenmesh.pc.in "$there/lib/pkgconfig/lumenmesh.pc"
echo "installed lumenmesh $version in $there"
