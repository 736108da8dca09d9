# Makes .venv with everything that demo, tests and benchmarks need. Does nothing when .venv is up to date.
# PYTHON: the Python to use; empty: the first of the candidates below that fits.
# VENV: another folder than .venv. EXTRAS: what to install of setup.py's extras; empty: the tests, and ROS unless sourced.
set -eu
cd "$(dirname "$0")/.."
venv=${VENV:-.venv}
fail() { echo "setup: $*" >&2; exit 1; }

# The interpreter itself, not a pyenv shim nor one of an active virtual environment. Fails if it is missing or too old.
base_of() {
    "$1" -c 'import os, sys
if sys.version_info < (3, 11): sys.exit(1)
print(os.path.join(sys.base_prefix, "bin", "python%d.%d" % sys.version_info[:2]))' 2>/dev/null </dev/null
}

python=
if [ -n "${PYTHON:-}" ]; then
    python=$(base_of "$PYTHON") || fail "PYTHON=$PYTHON does not run, or is older than Python 3.11"
fi

ros=${AMENT_PREFIX_PATH:+sourced}
where="$PWD ros=$ros${EXTRAS:+ extras=$EXTRAS}"
wants=$(cat setup.py setup.cfg tools/setup.sh | cksum)
was=$(cat "$venv/state" 2>/dev/null) || was=
current=$(base_of "$venv/bin/python") || current=
[ -z "$python" ] || [ "$python" = "$current" ] || current=
[ -z "$current" ] || [ "$was" != "$where $wants" ] || exit 0

# Debian and Ubuntu keep ensurepip in a package of its own: without it any of pip, virtualenv and uv will do.
make_venv() {
    site=${ros:+--system-site-packages}
    if "$python" -c 'import ensurepip' 2>/dev/null; then
        "$python" -m venv $site "$venv"
    elif "$python" -m pip --version >/dev/null 2>&1; then
        "$python" -m venv --without-pip $site "$venv"
        "$python" -m pip --python "$venv/bin/python" install -qq pip
    elif command -v virtualenv >/dev/null; then
        virtualenv -q -p "$python" $site "$venv"
    elif command -v uv >/dev/null; then
        uv venv -q --seed -p "$python" $site "$venv"
    else
        fail "${python##*/} cannot make virtual environments: sudo apt install ${python##*/}-venv"
    fi
}

# Kept: a finished .venv of this place, and one that somebody made by hand. Anything else is made anew.
case $was in "" | "$where "*) ;; *) current= ;; esac
if [ -n "$current" ] && [ ! -e "$venv/unfinished" ] && "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    echo "bringing $venv up to date"
else
    for candidate in python3.12 python3.11 python3.13 python3; do
        [ -z "$python" ] || break
        python=$(base_of "$candidate") || python=
    done
    [ -n "$python" ] || fail "no Python 3.11 or newer found: install one, or say make PYTHON=/path/to/python"
    rm -rf "$venv/bin" "$venv"
    make_venv
    echo "setting up $venv with ${python##*/} (once, a few minutes)"
fi
rm -f "$venv/state"
touch "$venv/COLCON_IGNORE" "$venv/unfinished"

extras=test,jazzy
if [ -n "${EXTRAS:-}" ]; then
    extras=$EXTRAS
elif [ -n "$ros" ] && "$venv/bin/python" -c 'import rclpy' 2>/dev/null; then
    extras=test
elif ! "$venv/bin/python" -c 'import platform, sys
sys.exit(not (sys.version_info < (3, 14) and sys.platform == "linux" and platform.machine() == "x86_64"))'; then
    fail "ROS 2 from PyPI needs Python 3.11 to 3.13 on x86-64 Linux: source ROS 2 Jazzy first, or say make PYTHON=..."
fi
"$venv/bin/python" -m pip install --disable-pip-version-check -qq -e ".[$extras]"
echo "$where $wants" >"$venv/state"
rm "$venv/unfinished"
