#!/usr/bin/env bash
# Unpack Debian's rustc with its standard libraries for x86-64 and 64-bit ARM into build/rust (134 MB of downloads).
#
#   tools/unpack_debian_rust.sh
#
# For `make wheels` on a machine where `rustup target add` cannot download a standard library. Nothing is installed: apt
# uses lists of this folder, so the system's architectures stay as they are.
set -euo pipefail
cd "$(dirname "$0")/.."

folder=$PWD/build/rust
lists=$PWD/build/rust-apt
mkdir -p "$lists"/{lists,cache/archives}/partial "$folder"
own() {
    # "$@" last, so that a command's own arguments follow the options.
    apt-get -q -o Dir::State::lists="$lists/lists" -o Dir::Cache="$lists/cache" -o APT::Architectures=amd64,arm64 \
        -o APT::Sandbox::User="$(id -un)" "$@"
}
own update >/dev/null
release=$(apt-cache -o Dir::State::lists="$lists/lists" -o Dir::Cache="$lists/cache" -o APT::Architectures=amd64,arm64 \
    depends libstd-rust-web-dev | sed -nE 's/.*Depends: (libstd-rust-web-[0-9.]+).*/\1/p' | head -n 1)
llvm=$(apt-cache -o Dir::State::lists="$lists/lists" -o Dir::Cache="$lists/cache" -o APT::Architectures=amd64,arm64 \
    depends "$release" | sed -nE 's/.*Depends: (libllvm[0-9]+).*/\1/p' | head -n 1)
(
    cd "$lists"
    rm -f ./*.deb
    own download rustc-web:amd64 libstd-rust-web-dev:amd64 "$release:amd64" "$llvm:amd64" \
        libstd-rust-web-dev:arm64
    for package in ./*.deb; do dpkg-deb -x "$package" "$folder"; done
)
rm -rf "$lists"
LD_LIBRARY_PATH=$folder/usr/lib/x86_64-linux-gnu "$folder/usr/bin/rustc" --version
