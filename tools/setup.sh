#!/usr/bin/env bash
# Installs what castnet needs and is missing: system packages (apt), and fpm and the
# Python packages in a private environment, .venv. Sourced by capture_cubesat.sh and
# test.sh; may be run by itself, any number of times.
#
# Afterwards: $castnet_root, $castnet_python, fpm on PATH, build_castnet.
#
#   CASTNET_VENV=DIR   another place for the private environment

castnet_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
castnet_venv=${CASTNET_VENV:-$castnet_root/.venv}
castnet_python=$castnet_venv/bin/python
# castnet_test_packages: what only the tests need, set by those who source this.
castnet_packages="gfortran gcc libhdf5-dev pkg-config python3-venv git ca-certificates ${castnet_test_packages:-}"

# One thread in the tests' LAPACK.
export OPENBLAS_NUM_THREADS=1
export LC_ALL=C.UTF-8

lacking() {
  printf '\n%s\n' "castnet: $*" >&2
  exit 1
}

# The Debian packages of the list that are not installed.
missing_packages() {
  local package
  for package in $castnet_packages; do
    # An installed package, or another one that provides it (pkgconf for pkg-config).
    [ "$(dpkg-query -W -f='${db:Status-Status}\n' "$package" 2>/dev/null | head -1)" = installed ] || printf '%s ' "$package"
  done
}

install_system_packages() {
  if ! command -v dpkg-query >/dev/null; then
    local tool
    for tool in gfortran gcc pkg-config python3 git; do
      command -v $tool >/dev/null || lacking "this is not Debian or Ubuntu, and '$tool' is missing." \
        "Install gfortran, gcc, HDF5 with its Fortran interface, pkg-config, git and Python 3.11 with venv (for the tests LAPACK too)," \
        "then run this again."
    done
    return 0
  fi
  local missing sudo=
  missing=$(missing_packages)
  missing=${missing% }
  [ -z "$missing" ] && return 0
  if [ "$(id -u)" -ne 0 ]; then
    # Without a terminal sudo must not ask for a password.
    if command -v sudo >/dev/null && { [ -t 0 ] || sudo -n true 2>/dev/null; }; then
      sudo=sudo
    else
      lacking "these packages are missing and this user may not install them: $missing." \
        "Ask an administrator to run: apt-get install -y $missing"
    fi
  fi
  echo "castnet: installing $missing"
  local log
  log=$(mktemp)
  { $sudo env DEBIAN_FRONTEND=noninteractive apt-get update -qq &&
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing
  } </dev/null >"$log" 2>&1 || {
    tail -5 "$log" >&2
    rm -f "$log"
    lacking "apt-get could not install: $missing. Is there a network? The command was: apt-get install -y $missing"
  }
  rm -f "$log"
}

install_python_packages() {
  local wanted="$castnet_root/tools/requirements.txt" stamp="$castnet_venv/castnet_requirements.txt"
  if [ -x "$castnet_python" ] && cmp -s "$wanted" "$stamp"; then return 0; fi
  if [ ! -x "$castnet_python" ] || ! "$castnet_python" -m pip --version >/dev/null 2>&1; then
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
      lacking "Python 3.11 or newer is needed, this is $(python3 --version 2>&1)."
    python3 -m venv --clear "$castnet_venv" ||
      lacking "could not make the private Python environment $castnet_venv. The command was: python3 -m venv $castnet_venv"
  fi
  echo "castnet: installing fpm and Python packages into $castnet_venv (a few minutes the first time)"
  "$castnet_python" -m pip install --quiet --disable-pip-version-check --no-input -r "$wanted" </dev/null ||
    lacking "pip could not install the Python packages. Is there a network? The command was:" \
      "$castnet_python -m pip install -r tools/requirements.txt"
  cp "$wanted" "$stamp"
}

# The flags of a build, as they stand in fpm.rsp behind its name.
build_flags() {
  sed -n "/^@$1\$/,/^\$/s/.*--flag \"\(.*\)\"\$/\1/p" "$castnet_root/fpm.rsp" | head -1
}

release_flags() { build_flags release; }

# The check build counts every line that it runs, for tools/coverage.py.
covered_check_flags() { printf '%s --coverage' "$(build_flags check)"; }
covered_c_flags="-O0 -g --coverage"

# The commit goes into one C file, so that `castnet version` and every result can name it;
# a plain `fpm @release` also builds, and says that it does not know.
commit_flags() {
  local commit
  commit=$(git -C "$castnet_root" describe --always --dirty --abbrev=12 2>/dev/null || true)
  printf '%s' "-O2${commit:+ -DCASTNET_COMMIT=$commit}"
}

# Build the Fortran tests and say where they are: built_tests PROFILE FLAGS C_FLAGS
built_tests() {
  local log
  log=$(mktemp)
  fpm test --target unit --profile "$1" --flag "$2" --c-flag "$3" --runner echo </dev/null >"$log" 2>&1 || {
    tail -40 "$log" >&2
    rm -f "$log"
    lacking "the build of the tests ($1) failed; the compiler's words stand above."
  }
  grep -E '/test/unit *$' "$log" | tail -1 | tr -d ' '
  rm -f "$log"
}

# Build the program of the covered check build, set $castnet_checked to it.
build_checked() {
  local flags log
  flags=$(covered_check_flags)
  log=$(mktemp)
  (cd "$castnet_root" && fpm build --profile debug --flag "$flags" --c-flag "$covered_c_flags") >"$log" 2>&1 </dev/null || {
    tail -40 "$log" >&2
    rm -f "$log"
    lacking "the check build failed; the compiler's words stand above."
  }
  rm -f "$log"
  castnet_checked=$castnet_root/$(cd "$castnet_root" && fpm run castnet --profile debug --flag "$flags" --c-flag "$covered_c_flags" \
    --runner echo 2>/dev/null </dev/null | grep -E '/castnet$' | tail -1)
  [ -x "$castnet_checked" ] || lacking "the check build finished, but the program is not where fpm says: $castnet_checked"
}

# HDF5 and the runtimes of Fortran and threads out of their archives, where they are all there: the
# program starts in 1.5 ms instead of 7, because shared HDF5 brings forty others along (tools/static_hdf5).
static_hdf5_flag() {
  local trial
  trial=$(mktemp)
  # shellcheck disable=SC2046
  if echo 'int H5open(void); int main(void) { return H5open() < 0; }' |
    gcc -x c - -L"$castnet_root/tools/static_hdf5" $(pkg-config --libs-only-L hdf5 2>/dev/null) -lhdf5 -lgfortran -lgomp -lm -ldl -o "$trial" 2>/dev/null; then
    printf '%s' -Ltools/static_hdf5
  fi
  rm -f "$trial"
}

# Build the release, set $castnet to the program.
build_castnet() {
  echo "castnet: building the release"
  local flags commit log link
  flags=$(release_flags)
  commit=$(commit_flags)
  link=$(static_hdf5_flag)
  log=$(mktemp)
  # fpm links anew only when it compiles something, and never takes an object out of a
  # library: without this, another commit's name or a removed module could stay in the program.
  rm -f "$castnet_root"/build/*/castnet/src_base_castnet_commit.c.o* "$castnet_root"/build/*/castnet/libcastnet.a*
  (cd "$castnet_root" && fpm build --profile release --flag "$flags" --c-flag "$commit" ${link:+--link-flag "$link"}) >"$log" 2>&1 </dev/null || {
    tail -40 "$log" >&2
    rm -f "$log"
    lacking "the release build failed; the compiler's words stand above."
  }
  rm -f "$log"
  castnet=$(cd "$castnet_root" && fpm run castnet --profile release --flag "$flags" --c-flag "$commit" ${link:+--link-flag "$link"} \
    --runner echo 2>/dev/null </dev/null | grep -E '/castnet$' | tail -1)
  case $castnet in /*) ;; *) castnet=$castnet_root/$castnet ;; esac
  [ -x "$castnet" ] || lacking "the build finished, but the program is not where fpm says: $castnet"
}

install_system_packages
install_python_packages
PATH=$castnet_venv/bin:$PATH
export PATH
