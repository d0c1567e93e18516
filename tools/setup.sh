#!/usr/bin/env bash
# Makes .venv with all that `make bake` and `make test` need, or does nothing if it is there. Run from the root.
#   PYTHON=path   the Python to use (3.11 or 3.13, for which Blender's module has wheels); found by itself otherwise.
set -euo pipefail

stamp="$(cksum <pyproject.toml) $PWD"
[ -f .venv/.stamp ] && [ "$(cat .venv/.stamp)" = "$stamp" ] && exit 0

# One set-up at a time; the others wait and then find it done.
exec 9>.setup.lock
if command -v flock >/dev/null; then flock 9; fi
trap 'rm -f .setup.lock' EXIT
[ -f .venv/.stamp ] && [ "$(cat .venv/.stamp)" = "$stamp" ] && exit 0

fits() { # a Python that really runs (a shim may not), of a version that Blender's module supports, and can make a venv
    "$1" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 13)))' 2>/dev/null
}
python=
for candidate in ${PYTHON:-} python3.13 python3.11 python3 python \
    "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.11.*/bin/python "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.13.*/bin/python; do
    if fits "$candidate"; then python=$candidate; break; fi
done
if [ -z "$python" ]; then
    echo "setup: needs Python 3.11 or 3.13 with the venv module (on Debian: apt install python3-venv)," \
        "and found neither; set PYTHON=/path/to/python" >&2
    exit 1
fi

# A .venv of another place or Python cannot be mended; one of an older pyproject only needs pip again.
if ! [ -x .venv/bin/python ] || [ "$(cat .venv/.place 2>/dev/null)" != "$PWD" ]; then
    rm -rf .venv
    "$python" -m venv .venv
    echo "$PWD" >.venv/.place
fi
rm -rf build
echo "setup: installing into .venv (some 450 MB the first time) ..."
install() {
    .venv/bin/python -m pip install --quiet --disable-pip-version-check "$@" >.venv/setup.log 2>&1 && return
    cat .venv/setup.log >&2
    echo "setup: could not install $*; see above" >&2
    exit 1
}
install --upgrade "pip>=24"
install --editable ".[blender,test,plot,cluster]"

libraries="libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1"
if ! .venv/bin/python -c 'import bpy' >/dev/null 2>&1; then
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        echo "setup: installing the system libraries that Blender's module needs ..."
        apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $libraries >/dev/null
    fi
    if ! message=$(.venv/bin/python -c 'import bpy' 2>&1); then
        echo "$message" | tail -n 1 >&2
        echo "setup: Blender's module does not start. On Debian or Ubuntu run: sudo apt-get install $libraries" >&2
        exit 1
    fi
fi
echo "$stamp" >.venv/.stamp
