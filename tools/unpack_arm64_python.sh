#!/usr/bin/env bash
# Unpack Debian's Python for 64-bit ARM and an emulator (qemu-user) into build/arm64 (60 MB of downloads).
#
#   tools/unpack_arm64_python.sh
#
# For `make test-wheels`, which then starts the ARM wheel on x86-64. Nothing is installed: apt uses lists of this folder, so
# the system's architectures stay as they are.
set -euo pipefail
cd "$(dirname "$0")/.."

folder=$PWD/build/arm64
lists=$PWD/build/arm64-apt
mkdir -p "$lists"/{lists,cache/archives}/partial "$folder"
own() {
    apt-get -q -o Dir::State::lists="$lists/lists" -o Dir::Cache="$lists/cache" -o APT::Architectures=amd64,arm64 \
        -o APT::Sandbox::User="$(id -un)" "$@"
}
own update >/dev/null
(
    cd "$lists"
    rm -f ./*.deb
    own download qemu-user-static:amd64
    packages=(libc6 libgcc-s1 libstdc++6 zlib1g libexpat1 libssl3 libffi8 libsqlite3-0 liblzma5 libbz2-1.0 libuuid1 libcrypt1
        libtinfo6 libncursesw6 libreadline8 python3.11-minimal libpython3.11-minimal libpython3.11-stdlib)
    own download "${packages[@]/%/:arm64}"
    for package in ./*.deb; do dpkg-deb -x "$package" "$folder"; done
)
rm -rf "$lists"
# Newer releases of Debian have the loader in usr/lib alone.
[ -e "$folder/lib" ] || ln -s usr/lib "$folder/lib"
"$folder/usr/bin/qemu-aarch64-static" -L "$folder" "$folder/usr/bin/python3.11" --version
