#!/usr/bin/env bash
# Compare the tools of this machine with the versions that a build needs, before anything is downloaded or compiled.
#
#   tools/check_build_tools.sh [INSTALLED...]
#
# INSTALLED are files that exist after a build; if one of them exists, the script prints only the missing tools. A tool
# chain is downloaded only after the user has agreed. Without a terminal the script prints the command and fails.
set -euo pipefail
cd "$(dirname "$0")/.."

field() { sed -nE "s/$1/\1/p" "$2" | head -n 1; }
rust_needed=$(field '^rust-version = "([0-9.]+)"' Cargo.toml)
node_needed=$(field '^ *"node": ">=([0-9.]+)".*' web/package.json)
python_needed=$(field '^requires-python = ">=([0-9.]+)"' pyproject.toml)

# at_least FOUND NEEDED: compare major and minor number.
at_least() {
    local -a found needed
    IFS=. read -r -a found <<<"$1"
    IFS=. read -r -a needed <<<"$2"
    ((${found[0]:-0} > needed[0] || (${found[0]:-0} == needed[0] && ${found[1]:-0} >= ${needed[1]:-0})))
}

# version COMMAND...: the first version number of the output, empty if the command fails.
version() {
    local text
    # A rustup without a tool chain would download one to answer.
    text=$(RUSTUP_AUTO_INSTALL=0 "$@" 2>/dev/null </dev/null) || return 0
    [[ $text =~ [0-9]+\.[0-9]+(\.[0-9]+)? ]] && printf %s "${BASH_REMATCH[0]}"
    return 0
}

problems=()
lines=()
# tool NAME NEEDED FOUND REMEDY
tool() {
    if [ -z "$3" ]; then
        lines+=("  $1 $2: missing")
        problems+=("$1 $2 or newer is missing: $4")
    elif at_least "$3" "$2"; then
        lines+=("  $1 $2: found $3")
    else
        lines+=("  $1 $2: found $3, too old")
        problems+=("$1 $2 or newer is needed, found $3: $4")
    fi
}

python=
for name in python3 python3.14 python3.13 python3.12 python3.11; do
    found=$(version "$name" --version)
    if [ -n "$found" ] && { [ -z "$python" ] || ! at_least "$python" "$python_needed"; }; then python=$found; fi
done
rust=$(version cargo --version)
rustc=$(version rustc --version)
# Debian installs rustc and cargo as separate packages, so the older of the two versions counts.
if [ -n "$rust" ] && { [ -z "$rustc" ] || ! at_least "$rustc" "$rust"; }; then rust=$rustc; fi

tool Python "$python_needed" "$python" "install python3 (Debian: apt install python3 python3-venv)"
if ! command -v uv >/dev/null && ! python3 -c 'import venv, ensurepip' 2>/dev/null; then
    lines+=("  python3-venv: missing")
    problems+=("the modules venv and ensurepip of Python are missing: apt install python3-venv")
fi
tool Rust "$rust_needed" "$rust" "install it by rustup (https://rustup.rs); with rustup: rustup update stable"
tool Node "$node_needed" "$(version node --version)" "install it from https://nodejs.org or by your system"
if ! command -v npm >/dev/null; then
    lines+=("  npm: missing")
    problems+=("npm, which belongs to Node, is missing: install it from https://nodejs.org or by your system")
fi
if ! command -v cc >/dev/null; then
    lines+=("  C compiler: missing")
    problems+=("a C compiler (cc) is missing: install it (Debian: apt install build-essential; macOS: xcode-select --install)")
fi

installed=
for file in "$@"; do
    if [ -e "$file" ]; then installed=yes; fi
done

if [ -z "$installed" ] || [ ${#problems[@]} -gt 0 ]; then
    echo "Carina needs Python $python_needed with python3-venv, Rust $rust_needed, Node $node_needed with npm, and a C compiler:"
    printf '%s\n' "${lines[@]}"
fi

# Only Rust is missing: rustup can put it into this folder, where `make` finds .rust/bin.
if [ ${#problems[@]} -eq 1 ] && [ -z "$rust" ] && [ -t 0 ] && [ -t 1 ]; then
    printf 'Download Rust from https://rustup.rs into .rust of this folder (about 200 MB, 0.7 GB on disk)? [y/N] '
    read -r answer || answer=
    case $answer in
        y | Y | yes)
            curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs |
                CARGO_HOME="$PWD/.rust/cargo" RUSTUP_HOME="$PWD/.rust/rustup" sh -s -- -y --profile minimal --no-modify-path
            bin=$(echo "$PWD"/.rust/rustup/toolchains/*/bin)
            ln -sfn "$bin" .rust/bin
            problems=()
            ;;
    esac
fi

if [ ${#problems[@]} -gt 0 ]; then
    printf '%s\n' "${problems[@]}" >&2
    echo "Nothing was downloaded. Run the command again when the tools are there." >&2
    exit 1
fi

if [ -z "$installed" ]; then
    cores=$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 1)
    # Estimated from a build of a fresh clone: 145 s of one core (2026-11, Rust 1.95, x86-64).
    minutes=$(((145 + 60 * cores - 1) / (60 * cores)))
    echo "Downloads: Python packages (about 110 MB) and libraries of the web UI (about 20 MB), into this folder."
    echo "Compiles: Rust crates and the web UI, about $minutes to $((2 * minutes)) min on $cores cores. Disk: about 0.7 GB."
fi
