#!/bin/sh
# Add Carina to the menu of the desktop; with --remove, remove it.
set -e
here=$(cd "$(dirname "$0")" && pwd)
entries=${XDG_DATA_HOME:-$HOME/.local/share}/applications
if [ "$1" = --remove ]; then
    rm -f "$entries/carina.desktop"
    exit
fi
mkdir -p "$entries"
sed "s|@FOLDER@|$here|g" "$here/share/applications/carina.desktop" > "$entries/carina.desktop"
echo "$entries/carina.desktop"
