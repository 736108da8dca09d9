# The tests of what may depend on the versions of Python and libraries, without ROS, on each supported Python that is
# installed and is not that of .venv: imports, files, configuration, commands, compiled code, golden replays. The replays
# run every algorithm from end to end; its tests in detail run on one Python.
set -eu
cd "$(dirname "$0")/.."
version_of() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null </dev/null; }

unset AMENT_PREFIX_PATH PYTHONPATH
main=$(version_of .venv/bin/python)
for version in 3.11 3.12; do
    [ "$version" != "$main" ] || continue
    python=
    for candidate in "python$version" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$version".*/bin/python; do
        [ -n "$python" ] || [ "$(version_of "$candidate")" != "$version" ] || python=$candidate
    done
    if [ -z "$python" ]; then
        echo "test-other: Python $version is not installed, skipped"
        continue
    fi
    VENV=".venv-$version" EXTRAS=test PYTHON="$python" sh tools/setup.sh
    echo "test-other: Python $version"
    PATH="$PWD/.venv-$version/bin:$PATH" python -m pytest -n 2 --dist loadgroup "$@" test/test_*.py test/cli test/config \
        test/golden test/mechanization/test_compiled.py test/messages test/recordings test/report test/simulation
done
