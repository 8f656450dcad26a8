#!/bin/sh
# Start Carina from the folder of this script.
path=$0
case $path in */*) ;; *) path=./$path ;; esac
while [ -L "$path" ]; do
    link=$(readlink "$path")
    case $link in /*) path=$link ;; *) path=${path%/*}/$link ;; esac
done
here=$(cd "${path%/*}/.." && pwd)
if ! "$here/bin/python@PYTHON@" -I -S -c '' 2>/dev/null; then
    echo "carina: this machine cannot run the programs of this folder. They need Linux on a 64-bit Intel or AMD processor with" >&2
    echo "glibc @GLIBC@ or newer (not musl). With Python 3.11 or newer, install the wheel instead: pip install carina-@RELEASE@-*.whl" >&2
    exit 1
fi
exec "$here/bin/python@PYTHON@" -I -m carina.cli "$@"
