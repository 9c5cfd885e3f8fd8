#!/usr/bin/env bash
# Builds what others install, and tries each in an empty place: the Python wheel and source archive, the crate as
# `cargo package` makes it, and a Debian package with the command, the C and C++ interface, man pages and shell
# completions.
#
#   scripts/package.sh [wheel] [sdist] [crate] [deb]     # all of them without arguments; they go to target/packages/
#   BUILT=FOLDER COMMAND=PROGRAM OUT=FOLDER scripts/package.sh deb    # of a library and command that are built already
#
# Needs Rust, Python with venv and pip, and for the Debian package dpkg-deb, binutils and a C compiler; with CMake the
# package is tried with that too.
set -euo pipefail
cd "$(dirname "$0")/.."
export XDG_RUNTIME_DIR="${XDG_RUNTIME_DIR:-$(mktemp -d)}"
root=$PWD
out=${OUT:-$root/target/packages}
mkdir -p "$out"
empty=$(mktemp -d)
trap 'rm -rf "$empty"' EXIT
say() { printf '\n== %s\n' "$*"; }
version=$(sed -n '/^\[workspace.package\]/,/^\[package\]/s/^version = "\(.*\)"$/\1/p' Cargo.toml)

maturin() {
  [ -x "$out/tools/bin/maturin" ] ||
    { python3 -m venv "$out/tools" && "$out/tools/bin/pip" install -q --disable-pip-version-check maturin; }
  "$out/tools/bin/maturin" "$@"
}

# A new environment with the package alone simulates, reconstructs and writes.
try_python() {
  python3 -m venv "$empty/$1"
  "$empty/$1/bin/pip" install -q --disable-pip-version-check "$2"
  (cd "$empty" && "$empty/$1/bin/python" - "$version" <<'PY'
import sys
import lumenmesh as lm

assert lm.__version__ == sys.argv[1], lm.__version__
recording, truth = lm.simulate("cylinder", seed=1, steady=True)
lumen = lm.reconstruct(recording)
assert lm.evaluate(lumen, truth)["mesh_to_truth"]["mean_mm"] < 0.2
lumen.save("vessel.vtp")
print(lumen)
PY
  )
}

wheel() {
  say "wheel"
  rm -f "$out"/*.whl
  maturin build --release --manifest-path python/Cargo.toml -o "$out"
  try_python wheel "$(ls "$out"/*.whl)"
}

sdist() {
  say "source archive for pip"
  rm -f "$out"/lumenmesh-*.tar.gz
  maturin sdist --manifest-path python/Cargo.toml -o "$out"
  try_python sdist "$(ls "$out"/lumenmesh-*.tar.gz)"
}

crate() {
  say "crate"
  # It is built from the archive, and a program of another folder depends on it.
  cargo package --allow-dirty --package lumenmesh
  cp "target/package/lumenmesh-$version.crate" "$out/"
  tar -C "$empty" -xzf "$out/lumenmesh-$version.crate"
  mkdir -p "$empty/host/src"
  cat > "$empty/host/Cargo.toml" <<TOML
[package]
name = "host"
version = "0.0.0"
edition = "2024"

[dependencies]
lumenmesh = { path = "../lumenmesh-$version", default-features = false }

[workspace]
TOML
  cat > "$empty/host/src/main.rs" <<'RS'
use lumenmesh::{reconstruction::Live, settings::Settings};

fn main() -> lumenmesh::Result<()> {
    let live = Live::new(&Settings::default())?;
    println!("{} rings", live.rings());
    Ok(())
}
RS
  [ "$(cargo run --quiet --manifest-path "$empty/host/Cargo.toml")" = "0 rings" ]
}

# The newest version of the C library that a symbol of the given files asks for.
newest_libc() { objdump -T "$@" | grep -o 'GLIBC_[0-9.]*' | cut -d_ -f2 | sort -uV | tail -1; }

deb() {
  say "Debian package"
  local architecture tree package
  architecture=$(dpkg --print-architecture)
  tree=$empty/deb
  package=$out/lumenmesh_${version}_$architecture.deb
  local built=${BUILT:-target/release} command=${COMMAND:-target/release/lumenmesh} pack=-Zxz
  [ -z "${BUILT:-}" ] || pack=-Znone
  [ -n "${BUILT:-}" ] || cargo build --release --all-features -p lumenmesh -p lumenmesh-capi
  install -Dm755 "$command" "$tree/usr/bin/lumenmesh"
  DESTDIR=$tree capi/install.sh /usr "$built"
  # As large as the rest together, and hardly used: whoever links it builds it.
  rm -f "$tree/usr/lib/liblumenmesh.a"
  strip --strip-unneeded "$tree/usr/bin/lumenmesh" "$tree"/usr/lib/liblumenmesh.so*
  mkdir -p "$tree/usr/share/man/man1"
  "$tree/usr/bin/lumenmesh" manual --out "$tree/usr/share/man/man1"
  gzip -9nf "$tree"/usr/share/man/man1/*.1
  completions() { mkdir -p "$tree/$(dirname "$2")" && "$tree/usr/bin/lumenmesh" completions "$1" > "$tree/$2"; }
  completions bash usr/share/bash-completion/completions/lumenmesh
  completions zsh usr/share/zsh/vendor-completions/_lumenmesh
  completions fish usr/share/fish/vendor_completions.d/lumenmesh.fish
  install -Dm644 -t "$tree/usr/share/doc/lumenmesh" README.md CHANGELOG.md
  cat LICENSE-MIT LICENSE-APACHE > "$tree/usr/share/doc/lumenmesh/copyright"
  mkdir -p "$tree/DEBIAN"
  cat > "$tree/DEBIAN/control" <<CONTROL
Package: lumenmesh
Version: $version
Architecture: $architecture
Maintainer: lumenmesh developers <noreply@localhost>
Section: science
Priority: optional
Installed-Size: $(du -sk "$tree/usr" | cut -f1)
Depends: libc6 (>= $(newest_libc "$tree/usr/bin/lumenmesh" "$tree"/usr/lib/liblumenmesh.so)), libgcc-s1
Recommends: mesa-vulkan-drivers
Description: from tracked intravascular ultrasound to a 3D mesh of the lumen
 The command lumenmesh, and its interface for C and C++.
CONTROL
  dpkg-deb --root-owner-group "$pack" --build "$tree" "$package"
  # Unpacked elsewhere, with nothing else: the command, its pages, and a program against the library.
  local there=$empty/installed
  dpkg-deb --extract "$package" "$there"
  (
    cd "$empty"
    "$there/usr/bin/lumenmesh" simulate --vessel cylinder --steady -o rec.mat --truth wall.vtp > /dev/null
    "$there/usr/bin/lumenmesh" reconstruct rec.mat -o vessel.vtp > /dev/null
    test -s vessel.vtp
    gzip -dc "$there/usr/share/man/man1/lumenmesh-reconstruct.1.gz" | grep -q 'lumenmesh\\-reconstruct'
    bash -c "source '$there/usr/share/bash-completion/completions/lumenmesh' && complete -p lumenmesh" > /dev/null
    cc -std=c99 -Wall -Werror -I "$there/usr/include" "$root/capi/examples/live.c" -L "$there/usr/lib" -llumenmesh -lm \
      -Wl,-rpath,"$there/usr/lib" -o live
    ./live live.vtp | grep -q vertices
    if command -v cmake > /dev/null; then
      mkdir -p consumer && cat > consumer/CMakeLists.txt <<CMAKE
cmake_minimum_required(VERSION 3.16)
project(host CXX)
find_package(lumenmesh $version REQUIRED)
add_executable(host $root/capi/examples/live.cpp)
target_link_libraries(host lumenmesh::lumenmesh)
CMAKE
      cmake -S consumer -B consumer/build -DCMAKE_PREFIX_PATH="$there/usr" > /dev/null
      cmake --build consumer/build > /dev/null
      consumer/build/host live.ply | grep -q vertices
    fi
  )
  say "$package: $(du -h "$package" | cut -f1)"
}

# shellcheck disable=SC2068
for what in ${@:-wheel sdist crate deb}; do "$what"; done
say "in $out: $(ls "$out" | grep -v tools | tr '\n' ' ')"
