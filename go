#!/bin/sh
# ./go COMMAND…   runs COMMAND in the environment that the lock files describe.
#
# The environment is .venv. It is made on the first run and brought up to date whenever pyproject.toml or a lock
# changed: requirements.lock has the packages of users, requirements-dev.lock the same packages and those of developers,
# which the first of the commands below adds. .venv/made-from holds copies of the files that .venv was made from and is
# put there last: without it a set-up was interrupted, and the next run starts afresh.
set -eu

root=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
venv=$root/.venv
pythons=${STEPGAP_PYTHON:-python3.13 python3.12 python3.11 python3}
developer_commands='coverage lint-imports mkdocs playwright pre-commit pyright pytest ruff twine'

say() {
    for line in "$@"; do
        printf 'go: %s\n' "$line" >&2
    done
}

fail() {
    say "$@"
    exit 1
}

fail_usage() {
    say "$1" "$usage"
    exit 2
}

needs_developer_packages() { # the arguments are a command: one of the list, or a Python program that imports such packages
    case " $developer_commands " in
    *" $1 "*) return ;;
    esac
    case "$*" in
    python*\ benchmarks/* | python*\ tests/*) return ;;
    python*\ -m\ *) shift && shift && needs_developer_packages "$@" ;;
    *) return 1 ;;
    esac
}

is_made_here() { # a finished environment, in the place where it was made, whose Python is still there
    [ -x "$venv/bin/python" ] && [ -f "$venv/made-from/root" ] && [ "$(cat "$venv/made-from/root")" = "$root" ]
}

has_developer_packages() {
    [ -f "$venv/made-from/requirements-dev.lock" ]
}

is_current() { # .venv was made from these files as they are now
    is_made_here || return
    for file in "$@"; do
        [ -f "$venv/made-from/$file" ] && [ "$(cat "$root/$file")" = "$(cat "$venv/made-from/$file")" ] || return
    done
}

is_up_to_date() { # for the lock that is needed; developers' packages stay once they are there
    if has_developer_packages; then
        lock=requirements-dev.lock
    fi
    is_current requirements.lock "$lock" pyproject.toml
}

find_python() { # sets python to the first that is new enough and can make an environment
    lacking=
    for name in $pythons; do
        python=$("$name" -I -c 'import sys; sys.version_info >= (3, 11) and print(sys.executable)' 2>/dev/null) || continue
        [ -n "$python" ] || continue
        if command -v uv >/dev/null || "$python" -I -c 'import venv, ensurepip' 2>/dev/null; then
            return
        fi
        lacking=${lacking:-$name}
    done
    [ -z "$lacking" ] ||
        fail "$lacking cannot make virtual environments: its modules venv and ensurepip are missing." \
            "Debian, Ubuntu: apt install $lacking-venv. Elsewhere: install uv."
    fail "Python 3.11 or newer is needed, and none of these is one: $pythons." \
        "Debian, Ubuntu: apt install python3 python3-venv (Ubuntu 22.04: python3.11 python3.11-venv)." \
        "Fedora: dnf install python3. macOS: brew install python."
}

under_lock() { # runs `go --set-up` while holding a lock on .venv.lock, which the kernel frees whatever happens
    "$python" -I -c '
import fcntl, os, sys
root, python, lock_file = sys.argv[1:]
lock = os.open(root + "/.venv.lock", os.O_RDWR | os.O_CREAT)
try:
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
except BlockingIOError:
    print("go: waiting for the set-up that another ./go has begun", file=sys.stderr, flush=True)
    fcntl.flock(lock, fcntl.LOCK_EX)
except OSError:
    pass  # a file system without locks
os.set_inheritable(lock, True)
os.execl("/bin/sh", "sh", root + "/go", "--set-up", python, lock_file)
' "$root" "$python" "$lock"
}

fetch_uv() { # with pip, in the version and with the hashes of the lock
    sed -n '/^uv==/,/[^\\]$/p' "made-from.new/$lock" >made-from.new/uv.txt
    bin/python -m pip install -qq --retries 2 --disable-pip-version-check --no-deps --only-binary :all: --require-hashes \
        --requirement made-from.new/uv.txt || fail_to_download
}

pip_setting() { # from its files; pip is in the environment unless uv made that, and seldom in Debian's own Python
    for interpreter in "$venv/bin/python" "${python:-python3}"; do # `pip config get` overlooks some of what `pip config list` finds
        if settings=$("$interpreter" -m pip config list 2>/dev/null); then
            printf '%s\n' "$settings" | sed -n "s/^global\.$1='\(.*\)'\$/\1/p"
            return
        fi
    done
}

use_pip_settings() { # uv does not read them
    if [ -z "${UV_DEFAULT_INDEX:-}${UV_INDEX_URL:-}${UV_INDEX:-}" ]; then
        mirror=${PIP_INDEX_URL:-$(pip_setting index-url)}
        [ -z "$mirror" ] || export UV_DEFAULT_INDEX="$mirror"
    fi
    if [ -z "${SSL_CERT_FILE:-}" ]; then
        certificates=${PIP_CERT:-$(pip_setting cert)}
        [ -z "$certificates" ] || export SSL_CERT_FILE="$certificates"
    fi
}

fail_to_download() {
    fail "the packages could not be installed; the reason stands above. Set-up needs the network: is there one?" \
        "Behind a proxy set HTTPS_PROXY, for a package mirror PIP_INDEX_URL. Then run it again."
}

installed() {
    ls -d lib/python*/site-packages/*.dist-info
}

make_afresh() {
    say "making .venv from $lock with $python (once, up to a minute or two)"
    rm -rf "$venv.old"
    [ ! -e "$venv" ] || mv "$venv" "$venv.old"
    rm -rf "$venv.old"
    if command -v uv >/dev/null; then
        uv venv --quiet --no-project --python "$python" "$venv" || fail "uv could not make .venv."
    else
        "$python" -m venv "$venv" || fail "$python could not make .venv. Debian, Ubuntu: apt install python3-venv"
    fi
}

install_lock() { # in place of all that is installed, the project itself too, or in addition to it
    if [ "$replaces" = yes ]; then
        set -- sync
    else
        set -- install --requirement
    fi
    # Where Python is told to write no bytecode, every start would compile all it imports anew: numba's takes a second.
    "$uv" pip "$@" "made-from.new/$lock" --quiet ${PYTHONDONTWRITEBYTECODE:+--compile-bytecode} --python bin/python \
        --require-hashes --no-build
}

set_up() { # python is the interpreter to make it with, lock the file to make it from
    if is_up_to_date; then
        return # another run was faster
    fi
    replaces=yes
    if ! is_made_here || [ -e "$venv/made-from.new" ]; then
        make_afresh
    elif is_current requirements.lock pyproject.toml && ! has_developer_packages; then
        say "adding the packages of developers to .venv (once)"
        replaces=no # nothing is removed: meanwhile, and if it fails, users' commands still run
    else
        say "bringing .venv up to date with $lock and pyproject.toml"
        rm -rf "$venv/made-from"
    fi
    cd "$venv"
    before=$(installed 2>/dev/null) || before=
    mkdir made-from.new
    for file in requirements.lock "$lock" pyproject.toml; do
        cp "$root/$file" made-from.new
    done
    printf '%s\n' "$root" >made-from.new/root
    uv=$(command -v uv || echo bin/uv)
    [ -x "$uv" ] || fetch_uv
    use_pip_settings
    install_lock || {
        [ "$before" != "$(installed)" ] || rm -rf made-from.new # nothing was changed: what works goes on working
        fail_to_download
    }
    [ "$replaces" = no ] ||
        "$uv" pip install --quiet --python bin/python --offline --no-deps --no-build-isolation --editable "$root" ||
        fail "the project itself could not be installed; the reason stands above."
    rm -rf made-from
    mv made-from.new made-from
}

usage='usage: ./go COMMAND…   for example: ./go pytest'
case ${1-} in
-h | --help)
    cat <<END
$usage

Runs COMMAND in the environment .venv, which it makes on the first run from requirements.lock. The first command of a
developer, such as pytest, adds the packages of requirements-dev.lock. CONTRIBUTING.md lists useful commands.
END
    exit
    ;;
'')
    fail_usage "a command is missing"
    ;;
--set-up)
    python=$2
    lock=$3
    set_up
    exit
    ;;
-*)
    fail_usage "there is no option $1"
    ;;
esac

lock=requirements.lock
if needs_developer_packages "$@"; then
    lock=requirements-dev.lock
fi
if ! is_up_to_date; then
    find_python
    under_lock
fi
if [ "$1" = uv ]; then
    use_pip_settings
fi
unset PYTHONHOME
export VIRTUAL_ENV="$venv" PATH="$venv/bin:$PATH" STEPGAP_GO="$0" # the last: how `stepgap` names commands to type
exec "$@"
