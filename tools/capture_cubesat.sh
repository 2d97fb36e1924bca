#!/usr/bin/env bash
# From a clean clone to a picture: installs what is missing, builds the release, runs
# the cubesat capture (input/cubesat.nml) and draws it. Can be run again without harm.
#
#   tools/capture_cubesat.sh [FOLDER]     results go to FOLDER, default out/
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

folder=${1:-$castnet_root/out}
mkdir -p "$folder" || lacking "cannot make the folder $folder."
build_castnet
echo "castnet: running input/cubesat.nml"
"$castnet" run "$castnet_root/input/cubesat.nml" --output "$folder/cubesat.h5" --force --quiet >/dev/null
echo "castnet: drawing"
"$castnet_python" "$castnet_root/tools/plot_run.py" "$folder/cubesat.h5" --output "$folder/cubesat.png" >/dev/null
echo
echo "results  $folder/cubesat.h5"
echo "picture  $folder/cubesat.png"
